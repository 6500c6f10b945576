"""A checkpoint, an exported file or a classical method, opened so that it can be scored."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from models import load_checkpoint
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.model_file import has_metadata
from runtime.contract.network_size import NetworkSize, check_network_size, network_size
from runtime.engine.preprocess import clean_sparse_depth
from training.base.processes import open_device, parse_device
from training.datasets.class_mapping import trained_classes
from training.evaluation.classical import CompletionMethod, create_method
from training.evaluation.foreign import open_foreign
from training.evaluation.predictions import Predictions
from training.scores.metrics import FARTHEST_M
from training.scores.scored_model import ScoredModel, open_exported, open_network
from training.scores.scoring import HeadMaps, Predict


@contextmanager
def open_scored_model(
    path: Path,
    *,
    device: str = "cpu",
    threads: int = 2,
    size: NetworkSize = None,
    adapters: list[Path] | None = None,
) -> Iterator[ScoredModel]:
    """Open `*.pt` with PyTorch, and `*.onnx` with the engine.

    An `*.onnx` of others runs in ONNX Runtime according to its adapter, see `open_foreign`.

    Args:
        path: a checkpoint or an exported model.
        device: "cpu", "cuda" or "cuda:N".
        threads: threads of the processor.
        size: size at which it runs, as `Predictor` takes it.
        adapters: adapters of networks of others; if this is such a network, the first is removed.

    Yields:
        The model; an exported one is closed at the end.

    Raises:
        InputError: if the file has another kind, the device is missing, or the size is invalid.
        CheckpointError, ContractError, ProviderError: if the file cannot be opened.
    """
    if path.suffix == ".pt":
        torch.set_num_threads(threads)
        checkpoint = load_checkpoint(path)
        network = checkpoint.model.to(open_device(device))
        asked = check_network_size(size, fixed=False)
        yield open_network(
            network,
            trained_classes(network.config.classes, checkpoint.facts),
            size_for=lambda frame_size: network_size(
                asked, frame_size, trained_height=checkpoint.facts.trained_height
            ),
        )
    elif path.suffix == ".onnx" and not has_metadata(path):
        place, adapter = parse_device(device), adapters.pop(0) if adapters else None
        foreign = open_foreign(path, adapter, place, threads, size)
        is_canonical = foreign.adapter.canonical_focal_px is not None
        yield ScoredModel(foreign, f"onnxruntime on {place.type}", foreign.table, is_canonical)
    elif path.suffix == ".onnx":
        with open_exported(path, device=device, threads=threads, size=size) as model:
            yield model
    else:
        raise InputError(f"{path}: expected a checkpoint (*.pt) or an exported model (*.onnx)")


def open_method(name: str) -> ScoredModel:
    """Open a classical method of depth completion by its name in `METHODS`.

    Raises:
        InputError: if the name is unknown.
    """
    return ScoredModel(method_predict(create_method(name)), "no network")


def open_predictions(text: str) -> tuple[Path, ScoredModel]:
    """Open answers, DIR[,KEY=VALUE...], see `Predictions`; return their folder, too.

    Raises:
        InputError, DatasetError: if a key is unknown, or there is no such folder.
    """
    recorded = Predictions.parse(text)

    def refuse(*_: object) -> HeadMaps:
        raise InputError(f"{recorded.folder}: answers that are read by the names of their frames")

    return recorded.folder, ScoredModel(
        refuse, "predictions", recorded.table, recorded=recorded.read
    )


def method_predict(method: CompletionMethod) -> Predict:
    """Return a classical method as a predictor.

    Negative, not finite and farther values than `FARTHEST_M` are no measurement; without any, all
    depths are 0. A depth of 0, no answer, is scored as a depth.
    """

    def predict(
        rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], focal_length_px: float | None
    ) -> HeadMaps:
        near = np.where(sparse_depth > FARTHEST_M, np.float32(0), sparse_depth)
        cleaned, _, _ = clean_sparse_depth(near, max_depth_m=FARTHEST_M)
        depth = method.complete(rgb, cleaned) if cleaned.any() else np.zeros_like(cleaned)
        if not np.isfinite(depth).all():
            raise SSDNetError(f"{type(method).__name__} answered with depths that are not finite")
        return HeadMaps(depth=depth)

    return predict
