"""Classical completion with the engine's face: where a `Predictor` can stand, it can stand."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.completion.method import CompletionMethod
from runtime.completion.methods import create_method
from runtime.contract import SCHEMA_VERSION, Contract, check_max_depth, resize_rules
from runtime.errors import InputError
from runtime.postprocess import faults
from runtime.prediction import DEPTH_INCOMPLETE, DEPTH_UNKNOWN, Latency, Prediction
from runtime.preprocess import preprocess

_WARM_UP_DEPTH_M, _WARM_UP_STEP = 10.0, 8


class CompletionPredictor:
    """Run a classical method of depth completion as `Predictor` runs a model: depth, nothing else.

    method: a name in `runtime.completion.methods.METHODS`, or a method with settings of one's own
    max_depth_m: returns beyond it are no measurement; no answer is beyond it

    It runs at the frame's own size, on one thread of the processor. There is no file behind it:
    `model`, `digest` and `node_counts` are None, and `contract` says the name and the range alone.

    Raises InputError for an unknown name or a range out of bounds, ProviderError where a package
    that the method needs is missing.
    """

    contract: Contract
    digest: None = None
    model: None = None
    provider: str = "cpu"
    providers: tuple[str, ...] = ("classical",)
    node_counts: None = None
    threads: int = 1
    input_size: None = None
    size: str = "frame"
    heads: tuple[str, ...] = ("depth",)
    load_ms: float
    first_inference_ms: float | None

    def __init__(self, method: str | CompletionMethod, *, max_depth_m: float = 100.0) -> None:
        started = time.perf_counter()
        name = method if isinstance(method, str) else type(method).__name__
        self._method = create_method(method) if isinstance(method, str) else method
        try:
            self.contract = _contract(name, check_max_depth(max_depth_m))
        except ValueError as error:
            raise InputError(str(error)) from error
        self.load_ms = _ms_since(started)
        self.first_inference_ms = None

    def predict(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        *,
        focal_length_px: float | None = None,
        stamp: Any = None,
    ) -> Prediction:
        """Complete the depth of one frame; arguments and cleaning as of `Predictor.predict`.

        No method heeds the focal length.

        `depth` is 0 where the method gives no answer, and `degraded` then holds "depth_incomplete".
        A network guesses depth from the picture where the LiDAR is silent; a filling has nothing to
        fill from: without any return `depth` is 0 everywhere, `valid` is False and `degraded` holds
        "no_depth" and "depth_unknown".

        Raises InputError for arrays of another type or shape, and what the method raises.
        """
        started = time.perf_counter()
        frame = preprocess(
            rgb,
            sparse_depth,
            max_depth_m=self.contract.max_depth_m,
            size_for=self.network_size,
        )
        preprocessed = time.perf_counter()
        depth = self._method.complete(frame.rgb, frame.sparse_depth)
        completed = time.perf_counter()
        reasons = faults({"depth": depth}, self.contract)
        usable = not reasons
        if not depth.any():
            usable, reasons = False, (*reasons, DEPTH_UNKNOWN)
        elif not depth.all():
            reasons = (*reasons, DEPTH_INCOMPLETE)
        finished = time.perf_counter()
        return Prediction(
            heads={"depth": depth},
            frame_size=frame.frame_size,
            network_size=frame.network_size,
            latency=Latency(
                preprocess_ms=(preprocessed - started) * 1e3,
                inference_ms=(completed - preprocessed) * 1e3,
                postprocess_ms=(finished - completed) * 1e3,
                total_ms=(finished - started) * 1e3,
            ),
            valid=usable,
            degraded=frame.degraded + reasons,
            cleaned=frame.cleaned,
            depth_returns=frame.depth_returns,
            stamp=stamp,
            contract=self.contract,
        )

    def network_size(self, frame_size: tuple[int, int]) -> tuple[int, int]:
        """Return the (height, width) at which the method runs: the frame's own."""
        return frame_size

    def warm_up(self, size: tuple[int, int], *, runs: int = 1) -> None:
        """Complete frames of `size` (height, width) with a regular grid of returns."""
        rgb = np.zeros((*size, 3), dtype=np.uint8)
        sparse_depth = np.zeros(size, dtype=np.float32)
        sparse_depth[::_WARM_UP_STEP, ::_WARM_UP_STEP] = _WARM_UP_DEPTH_M
        for _ in range(runs):
            latency = self.predict(rgb, sparse_depth).latency
            if self.first_inference_ms is None:
                self.first_inference_ms = latency.total_ms

    def close(self) -> None:
        """Free nothing: there is no session."""

    def __enter__(self) -> "CompletionPredictor":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _contract(name: str, max_depth_m: float) -> Contract:
    """What a model file would say; a method was exported by nobody and trained on nothing."""
    return Contract(
        schema_version=SCHEMA_VERSION,
        model_name=name,
        classes=(),
        max_depth_m=max_depth_m,
        native_size=(375, 1242),  # KITTI's, which the methods' settings were chosen for
        stride=1,
        resize=resize_rules(),
        precision="fp32",
        training={},
        versions={},
        parity={},
        checkpoint_sha256="",
    )


def _ms_since(started: float) -> float:
    return (time.perf_counter() - started) * 1e3
