"""Checkpoints: weights that carry their own configuration."""

import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models.network import Network
from models.registry import NETWORKS, Entry, find_network, registered_name
from models.training_facts import TrainingFacts
from runtime.base.arguments import shown
from runtime.base.errors import CheckpointError, OutputError
from runtime.files.atomic_write import atomic_file

# Files in the folder of a training: its recipe, the finished network, the best one so far, and the
# state from which the training resumes.
RECIPE, FINAL, BEST, LAST = "recipe.json", "model.pt", "best.pt", "last.pt"
FORMAT = "ssdnet-checkpoint"
VERSION = 2
_ZIP_START = b"PK\x03\x04"


@dataclass(frozen=True)
class Checkpoint:
    """The content of a checkpoint file.

    Attributes:
        model: the network, on the CPU, in evaluation mode.
        training: training data, terms and the recipe; plain values.
        trainer: state of the training loop (optimiser, step, ...); empty in a released checkpoint.
    """

    model: Network
    training: Mapping[str, Any]
    trainer: Mapping[str, Any] = field(default_factory=dict)

    @property
    def facts(self) -> TrainingFacts:
        """What the checkpoint says about its training.

        Raises:
            CheckpointError: if the height of its images is not a valid one.
        """
        try:
            return TrainingFacts.from_dict(self.training)
        except ValueError as error:
            raise CheckpointError(f"the checkpoint's {error}: train again") from error


def run_folder(path: Path) -> Path | None:
    """Return the folder of the training that wrote a checkpoint; None for any other file."""
    folder = path.resolve().parent
    return folder if path.name in (FINAL, BEST, LAST) and (folder / RECIPE).is_file() else None


def save_checkpoint(
    path: Path | str,
    model: Network,
    *,
    training: Mapping[str, Any] | None = None,
    trainer: Mapping[str, Any] | None = None,
) -> None:
    """Write a checkpoint whole or not at all; an existing file is replaced.

    The file holds the name under which the network is registered, its configuration (with classes,
    depth range and normalisation) and its weights.

    Args:
        path: file to write; its folder is created.
        model: the network.
        training: training data, terms and the recipe; plain values.
        trainer: state of the training loop; plain values and tensors.

    Raises:
        CheckpointError: if it cannot be written, or the network is not registered, so that the
            file could not be read; an existing file is then untouched.
    """
    path = Path(path)
    try:
        name = registered_name(model)
    except ValueError as error:
        raise CheckpointError(f"{path}: the checkpoint was not written: {error}") from error
    document = {
        "format": FORMAT,
        "version": VERSION,
        "network": name,
        "config": model.config.to_dict(),
        "weights": dict(model.state_dict()),
        "training": dict(training or {}),
        "trainer": dict(trainer or {}),
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, durable=True) as file:
            torch.save(document, file)
    except (OSError, OutputError, RuntimeError) as error:
        raise CheckpointError(
            f"{path}: the checkpoint could not be written: {error}: "
            "free some space or choose another folder"
        ) from error


def load_checkpoint(path: Path | str) -> Checkpoint:
    """Read a checkpoint strictly, without running any code from it.

    Weights in half precision are converted to single precision.

    Args:
        path: file that `save_checkpoint` wrote.

    Returns:
        The network on the CPU in evaluation mode, and the rest of the file's content.

    Raises:
        CheckpointError: if the file is missing, truncated or no checkpoint of this project, is of
            another version, or its weights do not fit its configuration.
    """
    path = Path(path)
    document = _read_document(path)
    if (version := document.get("version")) != VERSION:
        raise CheckpointError(
            f"{path}: checkpoint version {shown(version)}, but this installation reads version "
            f"{VERSION}: install a release that matches the file"
        )
    try:
        network, default = _find_class(str(document.get("network")))
    except ValueError as error:
        raise CheckpointError(
            f"{path}: holds a network that is not installed: {error}: install a release, or the "
            "package of the network, that matches the file"
        ) from error
    try:
        config = type(default).from_dict(document["config"])
        with torch.device("meta"):  # shapes only: a wrong configuration may need too much memory
            expected = network(config).state_dict()
    except (ValueError, TypeError, KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"{path}: its configuration cannot be built here ({_first_line(error)}): "
            "use it with the release that wrote it"
        ) from error
    try:
        check_weights(document["weights"], expected)
    except ValueError as error:
        raise CheckpointError(
            f"{path}: its weights do not fit its own configuration {config.name!r} ({error}); "
            "it was changed or comes from another release: use that release, or train again"
        ) from error
    model = network(config)
    model.load_state_dict(document["weights"])
    return Checkpoint(model.eval(), document["training"], document["trainer"])


# Files of earlier releases hold the name of the Python class -> a registered name of the class.
_CLASS_NAMES = {entry.network.__name__: name for name, entry in NETWORKS.items()}


def _find_class(name: str) -> Entry:
    """Return the network of a file by its registered name; ValueError for an unknown name."""
    return find_network(name if name in NETWORKS else _CLASS_NAMES.get(name, name))


def check_weights(weights: Mapping[str, object], expected: Mapping[str, Tensor]) -> None:
    """Raise ValueError unless the weights fit `expected`, a network's state on any device.

    Names and shapes must be the same; floating-point values may have any precision, others must
    have the same type.
    """
    missing = sorted(expected.keys() - weights.keys())
    unknown = sorted(map(str, weights.keys() - expected.keys()))
    for problem, names in (("lacks the tensors", missing), ("has the unknown tensors", unknown)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise ValueError(f"it {problem} {', '.join(names[:3])}{more}")
    for name, value in expected.items():
        weight = weights[name]
        if not isinstance(weight, Tensor):
            raise ValueError(f"{name} is not a tensor")
        if weight.shape != value.shape:
            raise ValueError(
                f"{name} has the shape {tuple(weight.shape)}, expected {tuple(value.shape)}"
            )
        if weight.dtype != value.dtype and not (
            weight.is_floating_point() and value.is_floating_point()
        ):
            raise ValueError(f"{name} is of type {weight.dtype}, expected {value.dtype}")


def _read_document(path: Path) -> dict[str, Any]:
    """Read what a checkpoint file of any version holds, without running any code from it."""
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint file: give the path of a .pt file")
    try:
        _check_archive(path)
        document = torch.load(path, map_location="cpu", weights_only=True)
    except CheckpointError:
        raise
    except pickle.UnpicklingError as error:  # PyTorch's message explains how to run the code
        raise CheckpointError(
            f"{path}: it contains objects other than tensors and plain values, which could run "
            "code when loaded: give a file that ssdnet-train wrote"
        ) from error
    except Exception as error:  # a damaged archive or pickle may raise any type
        raise CheckpointError(f"{path}: damaged ({_first_line(error)}): copy it again") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise CheckpointError(
            f"{path}: a PyTorch file, but not an ssdnet checkpoint (no 'format: {FORMAT}'): "
            "give a file that ssdnet-train wrote"
        )
    for key in ("config", "weights", "training", "trainer"):
        if not isinstance(document.get(key), dict):
            raise CheckpointError(f"{path}: the checkpoint lacks {key}: train again")
    return document


def _check_archive(path: Path) -> None:
    """Raise CheckpointError unless the file is a whole zip archive, as torch.save writes it."""
    with path.open("rb") as stream:
        start = stream.read(len(_ZIP_START))
    if not _ZIP_START.startswith(start):
        raise CheckpointError(
            f"{path}: not an ssdnet checkpoint: give a file that ssdnet-train wrote"
        )
    if not zipfile.is_zipfile(path):  # the archive's directory comes last
        raise CheckpointError(f"{path}: truncated ({path.stat().st_size} bytes): copy it again")
    with zipfile.ZipFile(path) as archive:
        if (name := archive.testzip()) is not None:  # torch.load does not compare checksums
            raise CheckpointError(
                f"{path}: damaged (the checksum of {shown(name)} is wrong): copy it again"
            )


def _first_line(error: BaseException) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
