"""The weights that a training starts from: a checkpoint's, by its path or its name."""

import sys
from importlib import resources
from pathlib import Path

from tqdm import tqdm

from models import Network, load_checkpoint
from runtime.errors import CheckpointError, InputError

#: Layers whose weights are of one class each.
_CLASS_LAYERS = ("semantic_head.",)
#: Settings that change what weights of the same shape mean.
_MEANINGS = {
    "max_depth_m": "the depth range [m]",
    "canonical_focal_px": "the focal length of the canonical camera [px]",
    "sparse_depth_gain": "the factor on the sparse depth",
    "boundary_gating": "the gating by boundaries",
}


def list_weights() -> list[str]:
    """Return the names of the checkpoints that are installed with the package."""
    return sorted(path.stem for path in _folder().glob("*.pt"))


def find_weights(text: str) -> Path:
    """Return the checkpoint that a command names.

    What ends in ".pt" or holds a slash is a path; anything else is a name of `list_weights`.
    Raises InputError for an unknown name.
    """
    if text.endswith(".pt") or "/" in text:
        return Path(text)
    if text not in list_weights():
        raise InputError(
            f"no weights are called {text!r}; known: {', '.join(list_weights())}. Give one of "
            "these, or the path of a .pt file."
        )
    return _folder() / f"{text}.pt"


def start_from(network: Network, init: Path) -> None:
    """Take over the weights of a checkpoint; layers that it lacks, or has in another shape, stay.

    So a network with other classes or another head starts from what is already known. Layers
    that tell classes apart stay as well where the classes are others, even as many. What starts
    anew, and what is taken over but means something else, is said on standard error. Raises
    CheckpointError if nothing fits.
    """
    source = load_checkpoint(init).model
    known = source.state_dict() if type(source) is type(network) else {}
    wanted = network.state_dict()
    names, known_names = (
        [info.name for info in model.config.classes or ()] for model in (network, source)
    )
    taken = {
        name: known[name]
        for name, value in wanted.items()
        if name in known
        and known[name].shape == value.shape
        and (names == known_names or not name.startswith(_CLASS_LAYERS))
    }
    fresh = sorted({name.rsplit(".", 1)[0] for name in wanted.keys() - taken.keys()})
    if not any(p.ndim > 1 and name in taken for name, p in network.named_parameters()):
        raise CheckpointError(
            f"{init}: none of its layers fits the recipe's '{network.config.name}'. "
            "Start from a checkpoint of the same family."
        )
    network.load_state_dict({**wanted, **taken})
    if fresh:
        tqdm.write(f"{init}: {len(taken)} of {len(wanted)} tensors taken over", file=sys.stderr)
        tqdm.write(f"starting anew: {', '.join(fresh)}", file=sys.stderr)
    for key, meaning in _MEANINGS.items():
        before, now = getattr(source.config, key, None), getattr(network.config, key, None)
        if before != now:
            tqdm.write(
                f"{init}: {meaning} was {before}, here it is {now}; its weights have to adapt",
                file=sys.stderr,
            )


def _folder() -> Path:
    return Path(str(resources.files("training"))) / "weights"
