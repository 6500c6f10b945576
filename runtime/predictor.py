"""The engine: one model, one verb."""

import operator
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundled_models import find_model
from runtime.contract import Contract, check_focal_length, check_size
from runtime.cores import available_cores
from runtime.errors import InferenceError, InputError
from runtime.model_file import load_model_file
from runtime.network_size import NetworkSize, check_network_size, network_size
from runtime.postprocess import faults, to_frame
from runtime.prediction import Latency, Prediction
from runtime.preprocess import NetworkInput, preprocess
from runtime.session import node_counts, open_session
from runtime.signature import check_outputs, read_signature

_MOST_THREADS = 1024


class Predictor:
    """Run a model of the contract: one picture and one sparse depth map in, its answers out.

    model: an ONNX file made by ssdnet-export, or the name of a bundled model ("ssdnet-lite"), see
        `find_model`; None = ssdnet-lite
    sha256: digest that the file must have, 64 hexadecimal digits; None = any
    provider: "cpu" or "cuda"; what is asked for is what runs
    device_id: which GPU
    size: at which size a model of free size runs; answers come at the frame's size all the same.
        None = at the height it was trained for, keeping the aspect, where the frame is larger by
        more than a quarter, else at the frame's own; "frame" = at the frame's own; a number of
        rows, keeping the aspect; or (height, width)
    focal_length_px: focal length of the camera in pixels of the frames as they are given to
        `predict`: a model with `contract.canonical_focal_px` then judges distances as this camera
        sees them, whatever its lens; None = as if the picture that the network sees were the
        canonical camera's. A model without works in plain metres and does not heed it
    threads: threads within an operator; None = the physical cores this process may use
    warmup: predictions made at once, at the model's own size, so that the first frame is not slow

    One predictor may be used by several threads at a time: `predict` and `predict_batch` keep
    nothing of a frame outside the call, and ONNX Runtime's sessions may be run side by side. The
    threads then share the same `threads` cores, so that several frames at once take longer each,
    and as long in sum: for several cameras it serves to keep the calling code simple. After any
    error of `predict` it stays usable. `close` lets calls that are under way end well.

    Raises ContractError for a missing, damaged, foreign or too new model, ProviderError if the
    provider cannot run it, InputError for arguments out of range and for any `size` but None where
    the model is of fixed size, and InferenceError where the warm-up fails.
    """

    contract: Contract
    digest: str  # sha256 of the model file, hexadecimal
    model: str  # path of the model file
    provider: str  # as asked for
    providers: tuple[str, ...]  # execution providers of the session
    node_counts: dict[str, int] | None  # execution provider -> nodes; None if not known
    threads: int
    input_size: tuple[int, int] | None  # (height, width) of a fixed model; None = any
    free_batch: bool  # whether one run of the model takes several frames
    size: NetworkSize  # as asked for
    focal_length_px: float | None  # of the frames; None = not known
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
        size: NetworkSize = None,
        focal_length_px: float | None = None,
        threads: int | None = None,
        warmup: int = 1,
    ) -> None:
        if threads is not None:
            threads = _require_count("threads", threads, at_least=1, at_most=_MOST_THREADS)
        warmup = _require_count("warmup", warmup, at_least=0)
        device_id = _require_count("device_id", device_id, at_least=0)
        self.focal_length_px = _check_focal_length(focal_length_px)
        started = time.perf_counter()
        path = find_model(model)
        file = load_model_file(path, sha256=sha256)
        self.model, self.digest, self.contract = str(path), file.sha256, file.contract
        self.provider = provider
        self.threads = threads or available_cores()
        self._device_id = device_id
        session = self._open_session(file.content)
        signature = read_signature(session, num_classes=len(self.contract.classes))
        self.input_size, self.heads = signature.size, signature.heads
        self.free_batch = signature.free_batch
        self.size = check_network_size(size, fixed=signature.size is not None)
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
        focal_length_px: float | None = None,
        stamp: Any = None,
    ) -> Prediction:
        """Predict classes, depth and boundaries of one frame.

        rgb: uint8 (H, W, 3), red first, as the camera gives it
        sparse_depth: float32 (H, W) [m] along the optical axis; 0 = no measurement, as is NaN,
            Inf, anything negative or beyond the range (counted in the answer). The range is
            `contract.max_depth_m`, for a model of canonical depth that times f /
            `contract.canonical_focal_px`, f the focal length in pixels of the network's picture
        focal_length_px: of this frame, where another than the predictor's
        stamp: handed through to the answer

        Where the network runs at another size (`network_size`), the frame is resized to it and the
        answers back by the contract's rule.

        Raises InputError for arrays of another type or shape and for a focal length out of range,
        InferenceError if the session fails, answers in another shape or was closed.
        """
        started = time.perf_counter()
        frame = self._preprocess(rgb, sparse_depth, focal_length_px)
        preprocessed = time.perf_counter()
        (outputs,) = self._run([frame])
        inferred = time.perf_counter()
        answers, found = to_frame(outputs, frame), faults(outputs, self.contract)
        finished = time.perf_counter()
        latency = Latency(
            preprocess_ms=(preprocessed - started) * 1e3,
            inference_ms=(inferred - preprocessed) * 1e3,
            postprocess_ms=(finished - inferred) * 1e3,
            total_ms=(finished - started) * 1e3,
        )
        return _prediction(answers, found, frame, latency, stamp, self.contract)

    def predict_batch(
        self,
        frames: Sequence[tuple[NDArray[np.uint8], NDArray[np.float32]]],
        *,
        focal_lengths_px: Sequence[float | None] | None = None,
        stamps: Sequence[Any] | None = None,
    ) -> list[Prediction]:
        """Predict the frames of several cameras with one call; the answers come in their order.

        frames: (rgb, sparse_depth) of each, as `predict` takes them, of any sizes
        focal_lengths_px: of each camera; None = the predictor's, for all or for one of them
        stamps: of each, handed through to its answer; None = none

        The frames that the network sees at one size (`network_size`) run as one batch where the
        file takes several frames (`free_batch`), as files of ssdnet-export do; other sizes run as
        batches of their own, one after another, as all frames do where the file takes one. The
        answers are those of `predict` but for rounding. A batch needs the memory of its frames
        together, and on one core it takes as long as they do one by one (1.00 to 1.02 times the
        processor's time: ssdnet-lite, 4 frames of 256 x 832, AMD EPYC, n = 6).

        Of an answer's latency `inference_ms` is the run of its batch, and `total_ms` the whole
        call: all answers come at once.

        Raises InputError naming the frame, before any of them runs, and InferenceError as `predict`
        does: then there is no answer for any.
        """
        started = time.perf_counter()
        focals = _one_each("focal_lengths_px", focal_lengths_px, frames)
        stamps = _one_each("stamps", stamps, frames)
        prepared, preprocess_ms = [], []
        for index, (frame, focal) in enumerate(zip(frames, focals, strict=True)):
            begun = time.perf_counter()
            try:
                rgb, sparse_depth = frame
                prepared.append(self._preprocess(rgb, sparse_depth, focal))
            except InputError as error:
                raise InputError(f"frame {index} of {len(frames)}: {error}") from error
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"frame {index} of {len(frames)} must be (rgb, sparse_depth): {error}"
                ) from error
            preprocess_ms.append(_ms_since(begun))
        groups: dict[object, list[int]] = {}
        for index, ready in enumerate(prepared):
            groups.setdefault(ready.network_size if self.free_batch else index, []).append(index)
        outputs: dict[int, dict[str, NDArray[Any]]] = {}
        inference_ms = {}
        for members in groups.values():
            begun = time.perf_counter()
            answered = self._run([prepared[index] for index in members])
            outputs.update(zip(members, answered, strict=True))
            inference_ms.update(dict.fromkeys(members, _ms_since(begun)))
        answers, found, postprocess_ms = [], [], []
        for index, ready in enumerate(prepared):
            begun = time.perf_counter()
            found.append(faults(outputs[index], self.contract))
            answers.append(to_frame(outputs[index], ready))
            postprocess_ms.append(_ms_since(begun))
        total_ms = _ms_since(started)
        return [
            _prediction(
                answers[index],
                found[index],
                ready,
                Latency(preprocess_ms[index], inference_ms[index], postprocess_ms[index], total_ms),
                stamps[index],
                self.contract,
            )
            for index, ready in enumerate(prepared)
        ]

    def network_size(self, frame_size: tuple[int, int]) -> tuple[int, int]:
        """Return the (height, width) at which the network runs for a frame of such a size.

        Raises InputError if the frame's aspect makes the rows that were asked for too wide.
        """
        return self.input_size or network_size(
            self.size, frame_size, trained_height=self.contract.trained_height
        )

    def warm_up(self, size: tuple[int, int], *, runs: int = 1) -> None:
        """Predict empty frames of `size` (height, width), so that memory and caches are ready.

        size: of the frames to come; the network runs at `network_size` of it. The time of the very
            first prediction is kept as `first_inference_ms`.
        Raises InputError for a size that cannot be, and what `predict` raises.
        """
        runs = _require_count("runs", runs, at_least=0)
        if not isinstance(size, Sequence):
            raise InputError(f"size must be (height, width), got {size!r:.80}")
        try:
            size = check_size([operator.index(side) for side in size])
        except (TypeError, ValueError) as error:
            raise InputError(f"size must be (height, width), got {size!r:.80}: {error}") from error
        rgb = np.zeros((*size, 3), dtype=np.uint8)
        sparse_depth = np.zeros(size, dtype=np.float32)
        for _ in range(runs):
            latency = self.predict(rgb, sparse_depth).latency
            if self.first_inference_ms is None:
                self.first_inference_ms = latency.total_ms

    def reset(self) -> None:
        """Open the session anew from the model file, on the same provider and device.

        For a provider that failed while running: `predict` raised InferenceError and goes on doing
        so, and a stream counts errors. Other threads may go on predicting meanwhile. Raises
        ContractError if the file is no longer the one that was opened, ProviderError if the
        provider cannot run it any more; the old session then stays.
        """
        file = load_model_file(Path(self.model), sha256=self.digest)
        self._session = self._open_session(file.content)

    def close(self) -> None:
        """Free the session. Predicting afterwards raises InferenceError."""
        self._session = None

    def __enter__(self) -> "Predictor":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _open_session(self, content: bytes) -> Any:
        return open_session(
            content, provider=self.provider, device_id=self._device_id, threads=self.threads
        )

    def _preprocess(self, rgb: Any, sparse_depth: Any, focal_length_px: Any) -> NetworkInput:
        focal = _check_focal_length(focal_length_px)
        return preprocess(
            rgb,
            sparse_depth,
            max_depth_m=self.contract.max_depth_m,
            size_for=self.network_size,
            canonical_focal_px=self.contract.canonical_focal_px,
            focal_length_px=self.focal_length_px if focal is None else focal,
        )

    def _run(self, frames: Sequence[NetworkInput]) -> list[dict[str, NDArray[Any]]]:
        """Run frames of one network size as one batch; head -> array, of each."""
        session = self._session
        if session is None:
            raise InferenceError("the predictor is closed: make a new one")
        height, width = frames[0].network_size
        feed = {
            "rgb": _batch([frame.rgb for frame in frames]),
            "sparse_depth": _batch([frame.sparse_depth for frame in frames]),
        }
        try:
            batches = session.run(self.heads, feed)
        except Exception as error:
            several = f"{len(frames)} frames" if len(frames) > 1 else "a frame"
            raise InferenceError(
                f"the session failed on {several} of {height} x {width}: {error}"
            ) from error
        outputs = dict(zip(self.heads, batches, strict=True))
        classes = len(self.contract.classes)
        check_outputs(outputs, frames=len(frames), size=(height, width), num_classes=classes)
        return [
            {head: batch[index] for head, batch in outputs.items()} for index in range(len(frames))
        ]


def _batch(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Arrays of one shape, one behind the other; a single one is not copied."""
    return arrays[0][np.newaxis] if len(arrays) == 1 else np.stack(arrays)


def _one_each(name: str, values: Any, frames: Any) -> list[Any]:
    """Values for each of the frames, None for all where there are none. Raises InputError."""
    if not isinstance(frames, Sequence):
        raise InputError(
            f"frames must be a list of (rgb, sparse_depth), got {type(frames).__name__}"
        )
    if values is None:
        return [None] * len(frames)
    try:
        given = list(values)
    except TypeError:
        given = []
    if len(given) != len(frames):
        raise InputError(f"{name} must hold one entry for each of {len(frames)} frames")
    return given


def _prediction(
    heads: dict[str, NDArray[Any]],
    found: tuple[str, ...],
    frame: NetworkInput,
    latency: Latency,
    stamp: Any,
    contract: Contract,
) -> Prediction:
    return Prediction(
        heads=heads,
        frame_size=frame.frame_size,
        network_size=frame.network_size,
        latency=latency,
        valid=not found,
        degraded=frame.degraded + found,
        cleaned=frame.cleaned,
        depth_returns=frame.depth_returns,
        stamp=stamp,
        contract=contract,
    )


def _check_focal_length(focal_px: Any) -> float | None:
    """Give back a focal length, None as it is. Raises InputError."""
    if focal_px is None:
        return None
    try:
        return check_focal_length(
            float(focal_px) if isinstance(focal_px, np.number) else focal_px, "focal_length_px"
        )
    except ValueError as error:
        raise InputError(
            f"{error}: give fx of the camera's matrix, in pixels of the frames, or leave it out"
        ) from error


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


def _ms_since(started: float) -> float:
    return (time.perf_counter() - started) * 1e3
