"""The engine: one model, one verb."""

import operator
import os
import time
from collections.abc import Sequence
from importlib import resources
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime import postprocess, preprocess
from runtime.contract import MIN_SIDE, Contract
from runtime.cores import available_cores
from runtime.errors import ContractError, InferenceError, InputError
from runtime.model_file import load_model_file
from runtime.prediction import (
    IMAGE_CONSTANT,
    NO_DEPTH,
    SPARSE_DEPTH_LOW,
    SPARSE_DEPTH_LOW_SHARE,
    Latency,
    Prediction,
)
from runtime.resize import move_returns, resize_image
from runtime.session import node_counts, open_session
from runtime.signature import read_signature

BUNDLED_MODEL = "ssdnet-lite.onnx"
_MOST_THREADS = 1024


class Predictor:
    """Run a model of the contract: one picture and one sparse depth map in, three answers out.

    model: an ONNX file made by ssdnet-export; None = the bundled model
    sha256: digest that the file must have, 64 hexadecimal digits; None = any
    provider: "cpu" or "cuda"; what is asked for is what runs
    device_id: which GPU
    threads: threads within an operator; None = the physical cores this process may use
    warmup: predictions made at once, at the model's own size, so that the first frame is not slow

    One predictor may be used by several threads at a time. After any error of `predict` it stays
    usable.

    Raises ContractError for a missing, damaged, foreign or too new model, ProviderError if the
    provider cannot run it, InputError for arguments out of range.
    """

    contract: Contract
    digest: str  # sha256 of the model file, hexadecimal
    model: str  # path of the model file
    provider: str  # as asked for
    providers: tuple[str, ...]  # execution providers of the session
    node_counts: dict[str, int] | None  # execution provider -> nodes; None if not known
    threads: int
    input_size: tuple[int, int] | None  # (height, width) of a fixed model; None = any
    heads: tuple[str, ...]  # for example ("semantic", "depth", "boundary")
    load_ms: float  # reading and optimising the model
    first_inference_ms: float | None  # the first of the warm-up; None without

    def __init__(
        self,
        model: str | bytes | PathLike[str] | None = None,
        *,
        sha256: str | None = None,
        provider: str = "cpu",
        device_id: int = 0,
        threads: int | None = None,
        warmup: int = 1,
    ) -> None:
        if threads is not None:
            threads = _require_count("threads", threads, at_least=1, at_most=_MOST_THREADS)
        warmup = _require_count("warmup", warmup, at_least=0)
        device_id = _require_count("device_id", device_id, at_least=0)
        started = time.perf_counter()
        path = _model_path(model)
        file = load_model_file(path, sha256=sha256)
        self.model, self.digest, self.contract = str(path), file.sha256, file.contract
        self.provider = provider
        self.threads = threads or available_cores()
        session = open_session(
            file.content, provider=provider, device_id=device_id, threads=self.threads
        )
        signature = read_signature(session, num_classes=len(self.contract.classes))
        self.input_size, self.heads = signature.size, signature.heads
        self.providers = tuple(session.get_providers())
        self.node_counts = node_counts(session)
        self._session: Any = session
        self.load_ms = _ms_since(started)
        self.first_inference_ms = None
        self.warm_up(self.input_size or self.contract.native_size, runs=warmup)

    def predict(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        *,
        stamp: Any = None,
    ) -> Prediction:
        """Predict classes, depth and boundaries of one frame.

        rgb: uint8 (H, W, 3), red first, as the camera gives it
        sparse_depth: float32 (H, W) [m] along the optical axis; 0 = no measurement, as is NaN,
            Inf, anything negative or beyond `contract.max_depth_m` (counted in the answer)
        stamp: handed through to the answer

        A model of fixed size gets the frame resized to it (`rgb` bilinear, `sparse_depth` by
        nearest), and its answers are resized back.

        Raises InputError for arrays of another type or shape, InferenceError if the session fails
        or the predictor was closed.
        """
        started = time.perf_counter()
        rgb = preprocess.check_rgb(rgb)
        frame_size = (rgb.shape[0], rgb.shape[1])
        sparse_depth = preprocess.check_sparse_depth(sparse_depth, size=frame_size)
        sparse_depth, cleaned, returns = preprocess.clean_sparse_depth(
            sparse_depth, max_depth_m=self.contract.max_depth_m
        )
        degraded = _input_reasons(rgb, returns)
        size = self.input_size or frame_size
        if size != frame_size:
            rgb = resize_image(rgb, size)
            sparse_depth = move_returns(sparse_depth, size)
        preprocessed = time.perf_counter()

        results = self._run(rgb, sparse_depth)
        inferred = time.perf_counter()

        faults = postprocess.faults(results, num_classes=len(self.contract.classes))
        if size != frame_size:
            results = {
                head: postprocess.resize_output(head, values, frame_size)
                for head, values in results.items()
            }
        finished = time.perf_counter()
        return Prediction(
            semantic=results.get("semantic"),
            depth=results.get("depth"),
            boundary=results.get("boundary"),
            semantic_logits=results.get("semantic_logits"),
            frame_size=frame_size,
            latency=Latency(
                preprocess_ms=(preprocessed - started) * 1e3,
                inference_ms=(inferred - preprocessed) * 1e3,
                postprocess_ms=(finished - inferred) * 1e3,
                total_ms=(finished - started) * 1e3,
            ),
            valid=not faults,
            degraded=degraded + faults,
            cleaned=cleaned,
            depth_returns=returns,
            stamp=stamp,
        )

    def warm_up(self, size: tuple[int, int], *, runs: int = 1) -> None:
        """Predict empty frames of `size` (height, width), so that memory and caches are ready.

        The time of the very first is kept as `first_inference_ms`. Raises InputError for a size
        that cannot be, and what `predict` raises.
        """
        runs = _require_count("runs", runs, at_least=0)
        if not isinstance(size, Sequence) or len(size) != 2:
            raise InputError(f"size must be (height, width), got {size!r}")
        height, width = size
        size = (
            _require_count("height", height, at_least=MIN_SIDE),
            _require_count("width", width, at_least=MIN_SIDE),
        )
        rgb = np.zeros((*size, 3), dtype=np.uint8)
        sparse_depth = np.zeros(size, dtype=np.float32)
        for _ in range(runs):
            latency = self.predict(rgb, sparse_depth).latency
            if self.first_inference_ms is None:
                self.first_inference_ms = latency.total_ms

    def close(self) -> None:
        """Free the session. Predicting afterwards raises InferenceError."""
        self._session = None

    def __enter__(self) -> "Predictor":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _run(
        self, rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32]
    ) -> dict[str, NDArray[Any]]:
        session = self._session
        if session is None:
            raise InferenceError("the predictor is closed: make a new one")
        feed = {"rgb": rgb[np.newaxis], "sparse_depth": sparse_depth[np.newaxis]}
        try:
            batches = session.run(self.heads, feed)
        except Exception as error:
            raise InferenceError(
                f"the session failed on a frame of {rgb.shape[0]} x {rgb.shape[1]}: {error}"
            ) from error
        results = {head: batch[0] for head, batch in zip(self.heads, batches, strict=True)}
        for head, values in results.items():
            if values.shape[-2:] != sparse_depth.shape:
                raise InferenceError(
                    f"the model gave {head} of {values.shape[-2:]} for a frame of "
                    f"{sparse_depth.shape}: export it again with ssdnet-export"
                )
        return results


def _require_count(name: str, value: Any, *, at_least: int, at_most: int = 2**31 - 1) -> int:
    try:
        count = operator.index(value)
    except TypeError:
        count = at_least - 1
    if isinstance(value, bool) or not at_least <= count <= at_most:
        limit = f" and at most {at_most}" if count > at_most else ""
        raise InputError(
            f"{name} must be a whole number of at least {at_least}{limit}, got {value!r}"
        )
    return count


def _model_path(model: str | bytes | PathLike[str] | None) -> Path:
    if model is None:
        bundled = resources.files("runtime") / "assets" / BUNDLED_MODEL
        if not bundled.is_file():
            raise ContractError(
                f"the bundled model {bundled} is missing: install ssdnet again, or name a model "
                "made by ssdnet-export"
            )
        return Path(str(bundled))
    try:
        return Path(os.fsdecode(model))
    except TypeError as error:
        raise InputError(
            f"model must be a path, got {type(model).__name__}: name an ONNX file, or none for "
            "the bundled model"
        ) from error


def _input_reasons(rgb: NDArray[np.uint8], returns: int) -> tuple[str, ...]:
    reasons = []
    if returns == 0:
        reasons.append(NO_DEPTH)
    elif returns < SPARSE_DEPTH_LOW_SHARE * rgb.shape[0] * rgb.shape[1]:
        reasons.append(SPARSE_DEPTH_LOW)
    if preprocess.is_constant(rgb):
        reasons.append(IMAGE_CONSTANT)
    return tuple(reasons)


def _ms_since(started: float) -> float:
    return (time.perf_counter() - started) * 1e3
