"""Checkpoints that a training begins with or learns from, by their path or their name."""

import hashlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn
from tqdm import tqdm

from models import Network, NetworkConfig, load_checkpoint
from models.training_facts import TrainingFacts
from runtime.base.errors import CheckpointError, InputError
from training.losses import LossConfig
from training.weights.prune import trunk_of, trunk_widths

# Layers with weights for each row of scores.
_CLASS_LAYERS = ("semantic_head.", "semantic_coarse_head.")
# How far copies of a row of scores are apart, as a share of the deviation of its layer's weights.
_APART = 0.01
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


def find_origins(relatives: Sequence[Sequence[str]], source: NetworkConfig) -> list[list[int]]:
    """Return the rows of scores of `source` with which each class begins, see `start_from`.

    Args:
        relatives: for each class, the names of the classes of `source` that it joins.
        source: the configuration of the initial weights; names in any case of letters.
    """
    rows: dict[str, list[int]] = {}
    counts = source.class_rows or (1,) * source.num_classes
    for info, count in zip(source.classes, counts, strict=True):
        first = sum(map(len, rows.values()))
        rows[info.name.casefold()] = [*range(first, first + count)]
    return [[row for name in names for row in rows.get(name.casefold(), [])] for names in relatives]


def start_from(
    network: Network, init: Weights, origins: Sequence[Sequence[int]], *, resumed: bool = False
) -> None:
    """Load the weights of the checkpoint `init`, as far as they fit.

    Layers that the checkpoint lacks or has in another shape keep their initial weights. A class
    begins with the rows of scores in `origins`, if it has any; a row that several classes begin
    with becomes copies that are a little apart. Layers and classes with random weights, classes of
    `init` that are left out, and settings that change what the weights compute, are reported on
    stderr, unless the run is `resumed`: it replaces all weights.

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
    for name in wanted.keys() & known.keys():
        if name.startswith(_CLASS_LAYERS):
            known[name] = _inherit_rows(network, name, known[name], origins)
    taken = {
        name: known[name]
        for name, value in wanted.items()
        if name in known and known[name].shape == value.shape
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
    say = partial(tqdm.write, file=sys.stderr)
    if fresh:
        say(f"{init.path}: {len(taken)} of {len(wanted)} tensors loaded")
        say(f"with random weights: {', '.join(fresh)}")
    for text in _describe_classes(network.config, source.config, origins) if known else ():
        say(f"{init.path}: {text}")
    for key in _MEANINGS:
        before, now = getattr(source.config, key, None), getattr(network.config, key, None)
        if before != now:
            say(f"{init.path}: {key} changed from {before} to {now}; the weights have to adapt")


def _inherit_rows(
    network: Network, name: str, source: Tensor, origins: Sequence[Sequence[int]]
) -> Tensor:
    """Return a class layer's tensor, with the rows of `source` that `origins` names."""
    layer, _, tensor = name.rpartition(".")
    # A transposed convolution has its outputs on the second axis.
    transposed = isinstance(network.get_submodule(layer), nn.ConvTranspose2d)
    axis = int(transposed and tensor == "weight")
    initial: Tensor = network.state_dict()[name]
    rows, old = initial.transpose(0, axis).clone(), source.transpose(0, axis)
    if rows.shape[1:] != old.shape[1:]:
        return initial
    order = [row for found in origins for row in (found or [-1])]
    for place, row in enumerate(order):
        if row >= 0:
            rows[place] = old[row]
            if order.count(row) > 1:
                rows[place] += _APART * old.std() * torch.randn_like(rows[place])
    joined: Tensor = rows.transpose(0, axis)
    return joined


def _describe_classes(
    config: NetworkConfig, source: NetworkConfig, origins: Sequence[Sequence[int]]
) -> Iterator[str]:
    """Yield what is random, and which classes of the initial weights are left out."""
    new = [info.name for info, rows in zip(config.classes, origins, strict=True) if not rows]
    if new:
        yield (
            f"classes that none of its classes is like begin at random: {', '.join(new)}; name "
            f"those that they join, as {new[0]} = road in --classes, or of = [...] in a recipe"
        )
    used = {row for rows in origins for row in rows}
    own = find_origins([(info.name,) for info in source.classes], source)
    left = [i.name for i, rows in zip(source.classes, own, strict=True) if used.isdisjoint(rows)]
    if left and len(new) < config.num_classes:
        yield f"its classes that none of yours joins are left out: {', '.join(left)}"


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
        wanted, found = (getattr(item.config, key) for item in (network, teacher))
        if key == "classes":  # in any colours
            wanted, found = ([info.name for info in table] for table in (wanted, found))
        if wanted != found:
            raise InputError(
                f"{given}: its {key} is {found}, that of the recipe {wanted}: give a "
                "teacher that was trained for the same, or change model.config"
            )
    return teacher.eval().requires_grad_(False)


def weights_folder() -> Path:
    """Return the folder of the checkpoints in the package."""
    return Path(__file__).parent
