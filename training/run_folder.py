"""The folder of a training: whose it is, and what lies in it."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models import remove_unfinished
from runtime.errors import InputError, SSDNetError
from runtime.writer import write_whole
from training.distributed import Processes

RECIPE = "recipe.json"
LAST = "last.pt"
FINAL = "model.pt"
NON_FINITE = "non_finite.json"
TENSORBOARD = "tensorboard"


class NonFiniteLossError(SSDNetError):
    """The loss became NaN or infinite; names the step and the file with the frames."""


def claim(out: Path, resolved: Mapping[str, Any]) -> None:
    """Make ``out`` this training's folder, or say that it is another's."""
    path = out / RECIPE
    text = json.dumps(resolved, indent=2, default=str)
    try:
        if path.is_file():
            if path.read_text(encoding="utf-8") != text:
                raise InputError(
                    f"{out}: holds a training with another recipe (see its recipe.json). "
                    "Choose another --out, or the recipe it was started with."
                )
            for name in (LAST, FINAL):
                remove_unfinished(out / name)
            return
        out.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written: {error.strerror}. Choose another --out."
        ) from error


def require_finite(
    terms: Mapping[str, Tensor], step: int, names: Sequence[str], out: Path, processes: Processes
) -> None:
    """Stop on a loss that is NaN or infinite, and save its terms and frames in ``out``.

    The loss is of all processes, so all of them stop. Raises NonFiniteLossError.
    """
    if torch.isfinite(terms["total"]):
        return
    path = out / NON_FINITE
    # Text: JSON has no NaN.
    values = {name: str(term.item()) for name, term in terms.items()}
    frames = [name for part in processes.gather(list(names)) for name in part]
    if processes.is_first:
        document = {"step": step, "terms": values, "frames": frames}
        write_whole(path, json.dumps(document, indent=2).encode())
    raise NonFiniteLossError(
        f"step {step}: the loss is {values['total']}; its terms and the {len(frames)} frames of "
        f"its batch are in {path}. Lower the learning rate or look at them; the same command goes "
        "on from the last checkpoint."
    )
