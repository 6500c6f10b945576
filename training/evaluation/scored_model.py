"""A checkpoint, an exported file or a classical method, opened so that it can be scored."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from models import CLASS_TABLES, Network, load_checkpoint
from models.training_facts import TrainingFacts
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.contract import ClassInfo
from runtime.contract.heads import HEADS
from runtime.contract.model_file import has_metadata
from runtime.contract.network_size import NetworkSize, check_network_size, network_size
from runtime.contract.resize import Size
from runtime.engine.predictor import Predictor
from runtime.engine.preprocess import clean_sparse_depth
from training.base.processes import open_device, parse_device
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import Sample
from training.evaluation.classical import CompletionMethod, create_method
from training.evaluation.foreign import open_foreign
from training.evaluation.predictions import Predictions
from training.scores.metrics import FARTHEST_M
from training.scores.scoring import HeadMaps, Predict, torch_predict


@dataclass(frozen=True)
class ScoredModel:
    """A model that is ready to predict, and the facts that its file records.

    Attributes:
        predict: answers one frame.
        engine: how it runs: "torch on cpu", "onnxruntime on cpu", "no network".
        table: the classes whose ids or boundaries it answers, see `trained_classes`; () if neither.
        is_canonical: whether its distances depend on the focal length of the frame.
        recorded: the answers themselves, if there is no network to run.
    """

    predict: Predict
    engine: str
    table: ClassTable = ()
    is_canonical: bool = False
    recorded: Predictions | None = None

    def predict_frame(
        self, sample: Sample, fed: NDArray[np.float32], image_name: str | None
    ) -> HeadMaps:
        """Return the answer to a frame.

        Args:
            sample: the frame.
            fed: its LiDAR input, float32 (H, W) [m].
            image_name: stem of its image, by which recorded answers are found; None if unknown.
        """
        if self.recorded is not None:
            return self.recorded.read(sample, image_name)
        return self.predict(sample.rgb, fed, sample.focal_length_px)


def trained_classes(classes: tuple[ClassInfo, ...], facts: TrainingFacts) -> ClassTable:
    """Return the classes of a file's training: a name in `models.CLASS_TABLES`, or its own table.

    A network without a semantic head learned the boundaries of these classes, too. If the file does
    not name the classes, they are CamVid's.

    Args:
        classes: classes of the file's semantic head.
        facts: what the file says about its training.
    """
    if not classes:
        return facts.classes
    names = [info.name for info in classes]  # files may have other colours
    for name, table in CLASS_TABLES.items():
        if [info.name for info in table] == names:
            return name
    return classes


def open_network(
    network: Network, table: ClassTable, *, size_for: Callable[[Size], Size] = lambda size: size
) -> ScoredModel:
    """Open a PyTorch network with the classes of its training; see `torch_predict`."""
    return ScoredModel(
        torch_predict(network, size_for=size_for),
        f"torch on {network.rgb_mean.device}",
        table if {"semantic", "boundary"} & {*network.heads} else (),
        network.config.canonical_focal_px is not None and "depth" in network.heads,
    )


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
        foreign = open_foreign(
            *(path, adapter),
            provider=place.type,
            device_id=place.index or 0,
            threads=threads,
            size=size,
        )
        is_canonical = foreign.adapter.canonical_focal_px is not None
        yield ScoredModel(foreign, f"onnxruntime on {place.type}", foreign.table, is_canonical)
    elif path.suffix == ".onnx":
        place = parse_device(device)
        with Predictor(
            path, provider=place.type, device_id=place.index or 0, size=size, threads=threads
        ) as predictor:
            contract, heads = predictor.contract, {*predictor.heads}
            table = trained_classes(contract.classes, TrainingFacts.from_dict(contract.training))
            yield ScoredModel(
                engine_predict(predictor),
                f"onnxruntime on {place.type}",
                table if {"semantic", "boundary"} & heads else (),
                contract.canonical_focal_px is not None and "depth" in heads,
            )
    else:
        raise InputError(f"{path}: expected a checkpoint (*.pt) or an exported model (*.onnx)")


def open_method(name: str) -> ScoredModel:
    """Open a classical method of depth completion by its name in `METHODS`.

    Raises:
        InputError: if the name is unknown.
    """
    return ScoredModel(method_predict(create_method(name)), "no network")


def open_predictions(text: str) -> ScoredModel:
    """Open a folder of answers, DIR[,KEY=VALUE...], see `Predictions`.

    Raises:
        InputError, DatasetError: if a key is unknown, or there is no such folder.
    """
    recorded = Predictions.parse(text)

    def refuse(*_: object) -> HeadMaps:
        raise InputError(f"{recorded.folder}: answers that are read by the names of their frames")

    return ScoredModel(refuse, "predictions", recorded.table, recorded=recorded)


def method_predict(method: CompletionMethod) -> Predict:
    """Return a classical method as a predictor.

    Negative, not finite and farther values than `FARTHEST_M` are no measurement. A depth of 0, no
    answer, is scored as a depth.
    """

    def predict(
        rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], focal_length_px: float | None
    ) -> HeadMaps:
        near = np.where(sparse_depth > FARTHEST_M, np.float32(0), sparse_depth)
        cleaned, _, _ = clean_sparse_depth(near, max_depth_m=FARTHEST_M)
        depth = method.complete(rgb, cleaned)
        if not np.isfinite(depth).all():
            raise SSDNetError(f"{type(method).__name__} answered with depths that are not finite")
        return HeadMaps(depth=depth)

    return predict


def engine_predict(predictor: Predictor) -> Predict:
    """Return the engine as a predictor; an invalid answer is an SSDNetError."""

    def predict(
        rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], focal_length_px: float | None
    ) -> HeadMaps:
        prediction = predictor.predict(rgb, sparse_depth, focal_length_px=focal_length_px)
        if not prediction.valid:
            raise SSDNetError(f"the model's answer is invalid: {', '.join(prediction.degraded)}")
        return HeadMaps(**{h: v for h, v in prediction.heads.items() if not HEADS[h].per_class})

    return predict
