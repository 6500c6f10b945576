"""The folder of a training: whose it is, and what lies in it."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from runtime.atomic_write import atomic_write
from runtime.errors import InputError, SSDNetError
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
    text = to_text(resolved)
    try:
        if path.is_file():
            if path.read_text(encoding="utf-8") != text:
                raise InputError(
                    f"{out}: holds a training with another recipe (see its recipe.json). "
                    "Choose another --out, or the recipe it was started with."
                )
            return
        out.mkdir(parents=True, exist_ok=True)
        atomic_write(path, text.encode())
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written: {error.strerror}. Choose another --out."
        ) from error


def to_text(resolved: Mapping[str, Any]) -> str:
    """A resolved recipe as the text of recipe.json."""
    return json.dumps(resolved, indent=2, default=str)


def name_weights(path: Path) -> str:
    """Name a checkpoint by its file and the start of its SHA-256."""
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from error
    return f"{path.name} (sha256 {digest[:12]})"


def require_finite(
    terms: Mapping[str, Tensor],
    value: Tensor,
    step: int,
    names: Sequence[str],
    out: Path,
    processes: Processes,
) -> None:
    """Stop if ``value``, the loss or the gradient's norm, is NaN or infinite.

    The terms and the frames of the batch are saved in ``out``. The value is of all processes, so
    all of them stop. Raises NonFiniteLossError.
    """
    if torch.isfinite(value):
        return
    path = out / NON_FINITE
    # Text: JSON has no NaN.
    values = {name: str(term.item()) for name, term in terms.items()}
    frames = [name for part in processes.gather(list(names)) for name in part]
    if processes.is_first:
        document = {"step": step, "terms": values, "frames": frames}
        atomic_write(path, json.dumps(document, indent=2).encode())
    raise NonFiniteLossError(
        f"step {step}: the loss is {values['total']}, the loss or its gradient not finite; its "
        f"terms and the {len(frames)} frames of its batch are in {path}. Look at them, or start a "
        f"new --out with --init {out / LAST} and a lower learning rate."
    )
