"""Checkpoints that a training begins with or learns from, by their path or their name."""

import hashlib
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from tqdm import tqdm

from models import Network, load_checkpoint
from models.training_facts import TrainingFacts
from runtime.base.errors import CheckpointError, InputError
from training.losses import LossConfig
from training.weights.prune import trunk_of, trunk_widths

# Layers with weights for each class.
_CLASS_LAYERS = ("semantic_head.", "semantic_coarse_head.")
# Buffers that hold settings of the configuration.
_SETTINGS = ("rgb_mean", "rgb_std")
# Settings that change what weights of the same shape compute.
_MEANINGS = (
    "max_depth_m",
    "farthest_guess_m",
    "canonical_focal_px",
    "sparse_depth_gain",
    "boundary_gating",
    "rgb_mean",
    "rgb_std",
)


@dataclass(frozen=True)
class Weights:
    """A checkpoint, read once.

    Attributes:
        path: its file.
        name: the file's name with the start of its SHA-256.
        network: the network, on the CPU, in evaluation mode.
        facts: the facts of its training.
    """

    path: Path
    name: str
    network: Network
    facts: TrainingFacts


def read_weights(path: Path) -> Weights:
    """Read a checkpoint; CheckpointError if it cannot be read."""
    checkpoint = load_checkpoint(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    name = f"{path.name} (sha256 {digest[:12]})"
    return Weights(path, name, checkpoint.model, checkpoint.facts)


def list_weights() -> list[str]:
    """Return the names of the checkpoints in the package."""
    return sorted(path.stem for path in weights_folder().glob("*.pt"))


def find_weights(text: str) -> Path:
    """Return the path of a checkpoint.

    Args:
        text: a path if it ends in ".pt" or contains a slash, else a name of `list_weights`.

    Raises:
        InputError: if the name is unknown.
    """
    if text.endswith(".pt") or "/" in text:
        return Path(text)
    if text not in list_weights():
        raise InputError(
            f"unknown weights {text!r}; known: {', '.join(list_weights())}: give one of these, or "
            "the path of a .pt file"
        )
    return weights_folder() / f"{text}.pt"


def start_from(network: Network, init: Weights, *, resumed: bool = False) -> None:
    """Load the weights of the checkpoint `init`, as far as they fit.

    Layers that the checkpoint lacks or has in another shape keep their initial weights, and so do
    the class layers where the classes differ. These layers, and settings that change what the
    weights compute, are reported on stderr, unless the run is `resumed`: it replaces all weights.

    Raises:
        CheckpointError: if nothing fits, or the trunk has other widths: its layers would be random.
    """
    source = init.network
    if trunk_of(source) and trunk_of(network):
        old, new = trunk_widths(source), trunk_widths(network)
        if old != new:
            raise CheckpointError(
                f"{init.path}: its trunk has other widths than model.config.encoder_widths = "
                f"{list(new)}: set that to {list(old)}, or prune the checkpoint first "
                "(`training.weights.prune.prune_trunk`)"
            )
    known = source.state_dict() if type(source) is type(network) else {}
    wanted = {k: v for k, v in network.state_dict().items() if k not in _SETTINGS}
    names, known_names = (
        [info.name for info in model.config.classes] for model in (network, source)
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
            f"{init.path}: none of its layers fits the recipe's '{network.config.name}': "
            "give a checkpoint of the same family"
        )
    network.load_state_dict({**network.state_dict(), **taken})
    if resumed:
        return
    if fresh:
        tqdm.write(f"{init.path}: {len(taken)} of {len(wanted)} tensors loaded", file=sys.stderr)
        tqdm.write(f"with random weights: {', '.join(fresh)}", file=sys.stderr)
    for key in _MEANINGS:
        before, now = getattr(source.config, key, None), getattr(network.config, key, None)
        if before != now:
            tqdm.write(
                f"{init.path}: {key} changed from {before} to {now}; the weights have to adapt",
                file=sys.stderr,
            )


def prepare_teacher(weights: Weights | None, loss: LossConfig, network: Network) -> Network | None:
    """Return the teacher of `network`; None if the loss compares with no teacher.

    Args:
        weights: checkpoint of the teacher; None if none was given.
        loss: the options of the loss, some of which need a teacher.
        network: the network that is trained.

    Returns:
        The teacher, without gradients and with its batch statistics frozen.

    Raises:
        InputError: if a loss needs a teacher that was not given, if a teacher was given that no
            loss needs, or if the teacher's answers mean something else: other classes, another
            range or camera.
    """
    heads = loss.taught_heads(network.heads)
    if weights is None:
        if not heads:
            return None
        raise InputError(
            f"loss.weights.distilled_{heads[0]} compares answers with a teacher's: give --teacher, "
            "for example --teacher ssdnet-lite, or set it to 0"
        )
    given = f"--teacher {weights.path.name}"
    if not heads:
        raise InputError(
            f"{given}: no weight loss.weights.distilled_... above 0 applies to the "
            f"heads of {network.config.name!r} ({', '.join(network.heads)}), so that nothing would "
            "be learned from it: set one, or leave --teacher out"
        )
    teacher = weights.network
    if missing := [head for head in heads if head not in teacher.heads]:
        raise InputError(
            f"{given}: has no head {missing[0]!r}: set "
            f"loss.weights.distilled_{missing[0]} = 0, or give a teacher with it"
        )
    for key in ("classes", "max_depth_m", "canonical_focal_px"):
        wanted, found = (_meaning(item, key) for item in (network, teacher))
        if wanted != found:
            raise InputError(
                f"{given}: its {key} is {found}, that of the recipe {wanted}: give a "
                "teacher that was trained for the same, or change model.config"
            )
    return teacher.eval().requires_grad_(False)


def _meaning(network: Network, key: str) -> object:
    """Return a setting that a network's answers depend on; for classes, their names."""
    value = getattr(network.config, key)
    return [info.name for info in value] if key == "classes" else value


def weights_folder() -> Path:
    """Return the folder of the checkpoints in the package."""
    return Path(str(resources.files("training"))) / "weights"
