"""The table of the bundled models, as commands print it."""

from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import assets_folder, find_model, list_bundled_models

# For each column: key in a row of `Contract.accuracy`, factor, digits.
_ACCURACY = {"mIoU %": ("miou", 100.0, 1), "MAE mm": ("mae_m", 1000.0, 0)}


def describe_bundled_models() -> str:
    """Return a table of the installed models: size, work and accuracy. Raises ContractError."""
    lines = [f"{'model':16}{'MB':>6}{'GMACs':>8}" + "".join(f"{name:>8}" for name in _ACCURACY)]
    notes: dict[str, None] = {}  # used as an ordered set
    for model in list_bundled_models():
        file = load_model_file(find_model(model))
        contract = file.contract
        line = f"{model:16}{len(file.content) / 1e6:6.1f}{_cell(contract.giga_macs, 1)}"
        notes["GMACs of a frame of {} x {}".format(*contract.native_size)] = None
        for name, (key, factor, digits) in _ACCURACY.items():
            rows = (contract.accuracy or {}).get("rows", [])
            row = next((row for row in rows if row[key] is not None), None)
            line += _cell(row and factor * row[key], digits)
            if row is not None:
                notes[f"{name} on {row['data']}, LiDAR {row['lidar']}"] = None
        lines.append(line)
    return "\n".join([*lines, *notes, f"more, and terms: {assets_folder() / 'MODEL_CARD.md'}"])


def _cell(value: float | None, digits: int) -> str:
    return f"{'n/a':>8}" if value is None else f"{value:8.{digits}f}"
