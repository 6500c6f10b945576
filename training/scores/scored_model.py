"""A network that is ready to be scored: in PyTorch, or exported and run by the engine."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from models import Network
from models.training_facts import TrainingFacts
from runtime.base.arrays import Size
from runtime.base.errors import SSDNetError
from runtime.contract.heads import HEADS
from runtime.contract.network_size import NetworkSize
from runtime.engine.predictor import Predictor
from training.base.processes import parse_device
from training.datasets.class_mapping import ClassTable, trained_classes
from training.datasets.sample import Sample
from training.scores.scoring import HeadMaps, Predict, torch_predict


@dataclass(frozen=True)
class ScoredModel:
    """A model that is ready to predict, and the facts that its file records.

    Attributes:
        predict: answers one frame.
        engine: how it runs: "torch on cpu", "onnxruntime on cpu", "no network".
        table: the classes whose ids or boundaries it answers, see `trained_classes`; () if neither.
        is_canonical: whether its distances depend on the focal length of the frame.
        recorded: returns the answer to a frame by the stem of its image, if there is no network to
            run.
    """

    predict: Predict
    engine: str
    table: ClassTable = ()
    is_canonical: bool = False
    recorded: Callable[[Sample, str | None], HeadMaps] | None = None


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
def open_exported(
    path: Path, *, device: str = "cpu", threads: int = 2, size: NetworkSize = None
) -> Iterator[ScoredModel]:
    """Open an exported model with the engine, and close it at the end; see `Predictor`.

    An invalid answer is an SSDNetError.
    """
    place = parse_device(device)
    with Predictor(
        path, provider=place.type, device_id=place.index or 0, size=size, threads=threads
    ) as predictor:
        contract, heads = predictor.contract, {*predictor.heads}

        def predict(
            rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], focal_length_px: float | None
        ) -> HeadMaps:
            answer = predictor.predict(rgb, sparse_depth, focal_length_px=focal_length_px)
            if not answer.valid:
                raise SSDNetError(f"the model's answer is invalid: {', '.join(answer.degraded)}")
            return HeadMaps(**{h: v for h, v in answer.heads.items() if not HEADS[h].per_class})

        table = trained_classes(contract.classes, TrainingFacts.from_dict(contract.training))
        yield ScoredModel(
            predict,
            f"onnxruntime on {place.type}",
            table if {"semantic", "boundary"} & heads else (),
            contract.canonical_focal_px is not None and "depth" in heads,
        )
