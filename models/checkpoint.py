"""Checkpoints: weights that carry their own configuration."""

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from models.checkpoint_checks import check_archive, check_weights
from models.network import Network
from models.registry import NETWORKS
from models.training_facts import TrainingFacts
from runtime.checks import shown
from runtime.errors import CheckpointError, OutputError
from runtime.io.atomic_write import atomic_file

FORMAT = "ssdnet-checkpoint"
VERSION = 2


@dataclass(frozen=True)
class Checkpoint:
    """The content of a checkpoint file."""

    #: The network, on the CPU, in evaluation mode.
    model: Network
    #: Training data, terms and the recipe; plain values.
    training: Mapping[str, Any]
    #: State of the training loop (optimiser, step, ...); empty in a released checkpoint.
    trainer: Mapping[str, Any] = field(default_factory=dict)

    @property
    def facts(self) -> TrainingFacts:
        """What it says about its training.

        Raises:
            CheckpointError: if the height of its images is not a valid one.
        """
        try:
            return TrainingFacts.from_dict(self.training)
        except ValueError as error:
            raise CheckpointError(f"the checkpoint's {error}. Train again.") from error


def save_checkpoint(
    path: Path | str,
    model: Network,
    *,
    training: Mapping[str, Any] | None = None,
    trainer: Mapping[str, Any] | None = None,
) -> None:
    """Write a checkpoint whole or not at all; an existing file is replaced.

    It holds the name of the network's class, its configuration (with classes, depth range and
    normalisation) and its weights.

    Args:
        path: file to write; its folder is made.
        model: the network.
        training: training data, terms and the recipe; plain values.
        trainer: state of the training loop; plain values and tensors.

    Raises:
        CheckpointError: if it cannot be written; an existing file is then untouched.
    """
    write_document(
        Path(path),
        {
            "format": FORMAT,
            "version": VERSION,
            "network": type(model).__name__,
            "config": model.config.to_dict(),
            "weights": dict(model.state_dict()),
            "training": dict(training or {}),
            "trainer": dict(trainer or {}),
        },
    )


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write what `save_checkpoint` does; raises the same."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, durable=True) as file:
            torch.save(document, file)
    except (OSError, OutputError, RuntimeError) as error:
        raise CheckpointError(
            f"{path}: the checkpoint could not be written: {error}. "
            "Free some space or choose another folder."
        ) from error


def load_checkpoint(path: Path | str) -> Checkpoint:
    """Read a checkpoint strictly, without running any code from it.

    Nothing is allocated beyond the file's own size before its weights are checked against its
    configuration. Weights in half precision are converted to single precision.

    Args:
        path: file that `save_checkpoint` wrote.

    Returns:
        The network on the CPU in evaluation mode, and the rest of the file's content.

    Raises:
        CheckpointError: if the file is missing, truncated or no checkpoint of this project, is of
            another version, or its weights do not fit its configuration.
    """
    path = Path(path)
    document = read_document(path)
    version = document.get("version")
    if not _is_equal(version, VERSION):
        raise CheckpointError(
            f"{path}: checkpoint version {shown(version)}, but this installation reads version "
            f"{VERSION}. Install a release that matches the file."
        )
    return restore(document, path)


def read_document(path: Path) -> dict[str, Any]:
    """Read what a checkpoint file holds, of any version, without running any code from it.

    Raises:
        CheckpointError: if the file is missing, damaged or no checkpoint.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint file. Give the path of a .pt file.")
    try:
        check_archive(path)
    except ValueError as error:
        raise CheckpointError(f"{path}: {error}") from error
    except Exception as error:  # a damaged archive can fail in any way
        raise CheckpointError(f"{path}: damaged ({_first_line(error)}). Copy it again.") from error
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:  # its text tells how to run the code
        raise CheckpointError(
            f"{path}: it contains objects other than tensors and plain values, which could run "
            "code when loaded. Give a file that ssdnet-train wrote."
        ) from error
    except Exception as error:  # so can a damaged pickle
        raise CheckpointError(f"{path}: damaged ({_first_line(error)}). Copy it again.") from error
    if not isinstance(document, dict) or not _is_equal(document.get("format"), FORMAT):
        raise CheckpointError(
            f"{path}: a PyTorch file, but not an ssdnet checkpoint (no 'format: {FORMAT}'). "
            "Give a file that ssdnet-train wrote."
        )
    for key in ("config", "weights", "training", "trainer"):
        if not isinstance(document.get(key), dict):
            raise CheckpointError(f"{path}: the checkpoint lacks {key}. Train again.")
    return document


def restore(document: Mapping[str, Any], path: Path) -> Checkpoint:
    """Build the network of a document of this version and load its weights.

    Raises:
        CheckpointError: if it cannot be built, or the weights do not fit it.
    """
    kind = str(document.get("network"))
    kinds = {entry.network.__name__: entry for entry in NETWORKS.values()}
    if kind not in kinds:
        raise CheckpointError(
            f"{path}: holds the network {shown(kind)}, but this installation knows "
            f"{', '.join(kinds)}. Install a release that matches the file."
        )
    try:
        config = type(kinds[kind].config).from_dict(document["config"])
        with torch.device("meta"):  # its shapes alone
            expected = kinds[kind].network(config).state_dict()
    except (ValueError, TypeError, KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"{path}: its configuration cannot be built here: {_first_line(error)}. "
            "Use it with the release that wrote it."
        ) from error
    try:
        check_weights(document["weights"], expected)
    except ValueError as error:
        raise CheckpointError(
            f"{path}: its weights do not fit its own configuration {config.name!r}: {error}. "
            "The file was changed, or comes from another release: use that release, or train again."
        ) from error
    model = kinds[kind].network(config)
    model.load_state_dict(document["weights"], strict=True)
    return Checkpoint(model.eval(), document["training"], document["trainer"])


def _is_equal(value: object, expected: str | int) -> bool:
    return type(value) is type(expected) and value == expected  # a tensor has no truth value


def _first_line(error: BaseException) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
