"""The class `Predictor`, which runs a model file on frames."""

import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any, NoReturn

import numpy as np

from runtime.base.arguments import check_integer, shown
from runtime.base.arrays import Float32, Size, UInt8
from runtime.base.errors import ContractError, InferenceError, InputError
from runtime.base.process_guard import ProcessGuard
from runtime.contract.canonical_focal import CameraScale, camera_scale
from runtime.contract.contract import check_focal_length, check_size
from runtime.contract.network_size import NetworkSize, check_network_size, network_size
from runtime.engine.bundled_models import find_model
from runtime.engine.cores import available_cores
from runtime.engine.inference import run_batch, to_prediction
from runtime.engine.model import open_model
from runtime.engine.prediction import Prediction, ms_since
from runtime.engine.preprocess import NetworkInput, preprocess
from runtime.engine.session import node_counts
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.units import check_field_of_view

_MOST_THREADS = 1024
_SMALL_SIZE = (64, 64)  # size of the frame that checks a model of free size
_GRAY = 128  # value of the pixels of an empty frame


class Predictor:
    """Run a model: it takes an image and a sparse depth map, and returns the answers.

    Several threads may use one predictor, because `predict` and `predict_batch` keep no data of a
    frame after the call. The threads share the same `threads` cores, so each frame takes longer if
    several are predicted at once. After an error in `predict` the predictor stays usable. Each
    process needs its own predictor: it cannot be pickled, and raises InferenceError after a fork.

    Args:
        model: an ONNX file made by ssdnet-export, or the name of a bundled model, see `find_model`;
            None: ssdnet-lite.
        sha256: SHA-256 that the file must have, 64 hexadecimal digits; None: any.
        provider: "cpu" or "cuda". The requested provider is used, or an error is raised.
        device_id: index of the GPU.
        size: size at which a model of free size runs; the answers always have the frame's size.
            None: the height for which the model was trained, with the aspect kept, if the frame
            is higher by more than a quarter; otherwise the frame's own size. "frame" = the frame's
            own size. An int = a number of rows, with the aspect kept. Or (height, width).
        focal_length_px: fx of the camera, in pixels of the frames that are given to `predict`. A
            model with `contract.canonical_focal_px` then scales distances for this camera, see
            `runtime.contract.canonical_focal`. None: the image is treated as if it came from the
            canonical camera.
        threads: threads within an operator; None: the physical cores this process may use.
        warmup: number of predictions that the constructor makes at the model's own size, so that
            the first frame is fast.

    Attributes:
        contract: what the model file states about itself.
        model: the open `Model`, with the `path` of its file and its `sha256`.
        provider: the requested provider.
        providers: ONNX Runtime's execution providers of the session.
        node_counts: execution provider -> number of graph nodes.
        threads: threads within an operator.
        size: (height, width) of a model of fixed size, else the requested size.
        focal_length_px: the focal length that was given.
        heads: names of the outputs, for example ("semantic", "depth", "boundary").
        load_ms: time for reading and optimising the model.
        first_inference_ms: time of the first warm-up prediction; None before it.

    Raises:
        ContractError: if the model is missing, damaged, foreign or of another version, or if its
            answer to an empty frame is not finite.
        ProviderError: if the provider cannot run the model.
        InputError: if an argument is out of range, if no bundled model has the name, or if `size`
            is given for a model of fixed size.
        InferenceError: if the model fails on an empty frame.
    """

    def __init__(
        self,
        model: str | PathLike[str] | None = None,
        *,
        sha256: str | None = None,
        provider: str = "cpu",
        device_id: int = 0,
        size: NetworkSize = None,
        focal_length_px: float | None = None,
        threads: int | None = None,
        warmup: int = 1,
    ) -> None:
        if threads is None:
            self.threads = available_cores()
        else:
            self.threads = check_integer("threads", threads, 1, _MOST_THREADS, error=InputError)
        warmup = check_integer("warmup", warmup, 0, error=InputError)
        device_id = check_integer("device_id", device_id, 0, error=InputError)
        self.focal_length_px = _check_focal_length(focal_length_px)
        self._guard = ProcessGuard("Predictor")

        started = time.perf_counter()
        path = find_model(model)
        self._open_model = partial(
            open_model, path, provider=provider, device_id=device_id, threads=self.threads
        )
        self.model, session = self._open_model(sha256=sha256)
        self.provider = provider
        self.contract, self.heads = self.model.contract, self.model.heads
        fixed_size = self.model.size
        self.size = check_network_size(size, fixed=fixed_size is not None) or fixed_size
        self.providers = tuple(session.get_providers())
        self.node_counts = node_counts(session)
        self._session: Any = session
        self.load_ms = ms_since(started)
        if provider == "cpu" and self.contract.precision == "fp16":
            warnings.warn(
                f"{path.name} is in half precision, which is for GPUs: on the processor the same "
                "model in fp32 gives the same answers faster",
                RuntimeWarning,
                stacklevel=2,
            )
        self.first_inference_ms: float | None = None
        if warmup:
            self.warm_up(fixed_size or self.contract.native_size, runs=warmup)
        else:
            self._predict_empty(fixed_size or _SMALL_SIZE)

    def predict(
        self,
        rgb: UInt8,
        sparse_depth: Float32 | None = None,
        *,
        focal_length_px: float | None = None,
        stamp: Any = None,
    ) -> Prediction:
        """Predict the heads of one frame.

        If the network runs at another size (`network_size`), the frame is resized to that size, and
        the answers are resized to the frame.

        Args:
            rgb: uint8 (H, W, 3), RGB, not BGR.
            sparse_depth: float32 (H, W), metres along the optical axis; 0 = no measurement. NaN,
                Inf, negative values, and values beyond both 250 m and the range (`camera_scale`)
                are no measurement either. Other returns beyond the range are clipped to it.
                `Prediction.cleaned` counts all these pixels. None: predict from the image alone.
            focal_length_px: fx of this frame's camera; None: the predictor's.
            stamp: any value; it is returned in the answer.

        Returns:
            The answers at the frame's size (H, W).

        Raises:
            InputError: if an array has another type or shape, or the focal length is out of range.
            InferenceError: if the session fails, its outputs have another shape, or the predictor
                is closed.
        """
        frame = self._preprocess(rgb, sparse_depth, focal_length_px)
        (prediction,) = self._run([frame], [stamp])
        return prediction

    def predict_batch(
        self,
        frames: Sequence[tuple[UInt8, Float32 | None]],
        *,
        focal_lengths_px: Sequence[float | None] | None = None,
        stamps: Sequence[Any] | None = None,
    ) -> list[Prediction]:
        """Predict the frames of several cameras with one call.

        Frames of the same `network_size` run as one batch if the file takes several frames
        (`model.free_batch`); frames of different sizes run one after another. The answers equal
        those of `predict` except for rounding. On one core a batch takes as long as its frames one
        by one.

        Args:
            frames: (rgb, sparse_depth) of each camera, as for `predict`, of any sizes.
            focal_lengths_px: focal length of each camera; None for all or for one of them = the
                predictor's.
            stamps: any value for each frame, which is returned in its answer; None: no stamps.

        Returns:
            The answers in the order of the frames. `latency.inference_ms` is the time of the
            frame's batch, and `latency.total_ms` that of the whole call.

        Raises:
            InputError: if a frame is invalid; the message names it, and no frame is predicted.
            InferenceError: as for `predict`; there is then no answer for any frame.
        """
        started = time.perf_counter()
        try:
            frames = list(frames)
        except TypeError as error:
            raise InputError(f"frames must be (rgb, sparse_depth) of each: {error}") from error
        focals = _one_each("focal_lengths_px", focal_lengths_px, len(frames))
        stamps = _one_each("stamps", stamps, len(frames))
        batches: dict[object, list[tuple[int, NetworkInput]]] = {}
        for index, (frame, focal) in enumerate(zip(frames, focals, strict=True)):
            named = f"frame {index} of {len(frames)}"
            try:
                rgb, sparse_depth = frame
            except (TypeError, ValueError) as error:
                raise InputError(f"{named} must be (rgb, sparse_depth): {error}") from error
            try:
                ready = self._preprocess(rgb, sparse_depth, focal)
            except InputError as error:
                raise InputError(f"{named}: {error}") from error
            key = ready.network_size if self.model.free_batch else index
            batches.setdefault(key, []).append((index, ready))
        answers: dict[int, Prediction] = {}
        for members in batches.values():
            places, inputs = zip(*members, strict=True)
            predictions = self._run(inputs, [stamps[place] for place in places])
            answers.update(zip(places, predictions, strict=True))
        total_ms = ms_since(started)
        ordered = (answers[place] for place in range(len(frames)))
        return [replace(each, latency=replace(each.latency, total_ms=total_ms)) for each in ordered]

    def network_size(self, frame_size: Size) -> Size:
        """Return the (height, width) at which the network runs for a frame.

        Args:
            frame_size: (height, width) of the frame.

        Raises:
            InputError: if the requested rows would be too wide with the frame's aspect.
        """
        return network_size(self.size, frame_size, trained_height=self.contract.trained_height)

    def camera_scale(
        self, frame_size: Size, *, focal_length_px: float | None = None
    ) -> CameraScale:
        """Return the depth range for a frame, and the focal length that is used.

        An `AssumptionWarning` is issued if the frame would show more than 150 degrees with this
        focal length.

        Args:
            frame_size: (height, width) of the frame.
            focal_length_px: fx of this frame's camera; None: the predictor's.

        Raises:
            InputError: as for `network_size`, and if the focal length is out of range.
        """
        focal_px = _check_focal_length(focal_length_px) or self.focal_length_px
        if focal_px is not None:
            check_field_of_view(focal_px, frame_size[1])
        of_model = self.contract.max_depth_m, self.contract.canonical_focal_px
        size = self.network_size(frame_size)
        return camera_scale(*of_model, focal_px, frame_size=frame_size, network_size=size)

    def warm_up(self, size: Size, *, runs: int = 1) -> None:
        """Predict gray frames without returns, so that memory and caches are ready.

        The time of the very first prediction is kept as `first_inference_ms`.

        Args:
            size: (height, width) of the frames to come.
            runs: number of predictions.

        Raises:
            InputError: for an invalid size.
            ContractError: if an answer is not finite.
            InferenceError: as `predict`.
        """
        runs = check_integer("runs", runs, 0, error=InputError)
        try:
            size = check_size(size)
        except ValueError as error:
            raise InputError(str(error)) from error
        for _ in range(runs):
            prediction = self._predict_empty(size)
            if self.first_inference_ms is None:
                self.first_inference_ms = prediction.latency.total_ms

    def reset(self) -> None:
        """Open the session again from the model file, on the same provider and device.

        This is the remedy if a provider failed and `predict` keeps raising InferenceError. Other
        threads may continue to predict in the meantime. After an error the old session is kept.

        Raises:
            ContractError: if the file is no longer the one that was opened.
            ProviderError: if the provider can no longer run it.
            InferenceError: after `close`.
        """
        self._require_open()
        _, self._session = self._open_model(sha256=self.model.sha256)

    def close(self) -> None:
        """Free the session; calls in progress end normally, later ones raise InferenceError."""
        if not self._guard.is_forked:  # a forked session waits for threads that do not exist
            self._session = None

    def __reduce__(self) -> NoReturn:
        raise InputError(
            "a Predictor cannot be pickled or copied: give the path of its model, and make a "
            "Predictor in each process"
        )

    def __repr__(self) -> str:
        """Return the model, and the options that are not the defaults' alone."""
        size, focal_px = self.size, self.focal_length_px
        given = f"provider={self.provider!r}, size={size}, focal_length_px={focal_px}"
        return f"Predictor({str(self.model.path)!r}, {given}, threads={self.threads})"

    def __enter__(self) -> "Predictor":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _require_open(self) -> Any:
        """Return the session. Raises InferenceError after `close` and in a forked process."""
        self._guard.check()
        if (session := self._session) is None:
            raise InferenceError("the predictor is closed: make a new one")
        return session

    def _predict_empty(self, size: Size) -> Prediction:
        """Predict a gray frame without returns. Raises ContractError unless it is finite."""
        with collect_assumptions([]):  # the focal length may be of frames of another size
            prediction = self.predict(np.full((*size, 3), _GRAY, np.uint8))
        if broken := [each for each in prediction.degraded if each.endswith("_not_finite")]:
            raise ContractError(
                f"the model's answer to an empty frame is not finite ({', '.join(broken)}): export "
                "it again with ssdnet-export, or get another"
            )
        return prediction

    def _run(self, frames: Sequence[NetworkInput], stamps: Sequence[Any]) -> list[Prediction]:
        """Run frames of one network size as one batch."""
        started = time.perf_counter()
        outputs = run_batch(self._require_open(), self.heads, frames, self.contract)
        inference_ms = ms_since(started)
        return [
            to_prediction(each, frame, self.contract, inference_ms, stamp=stamp)
            for each, frame, stamp in zip(outputs, frames, stamps, strict=True)
        ]

    def _preprocess(self, rgb: Any, sparse_depth: Any, focal_length_px: Any) -> NetworkInput:
        scale_for = partial(self.camera_scale, focal_length_px=focal_length_px)
        return preprocess(rgb, sparse_depth, size_for=self.network_size, scale_for=scale_for)


def _one_each(name: str, values: Any, count: int) -> list[Any]:
    """Return one value for each frame; `values` None gives None for each. Raises InputError."""
    try:
        entries: list[Any] = [None] * count if values is None else list(values)
    except TypeError:
        entries = []
    if len(entries) != count or isinstance(values, str):
        raise InputError(
            f"{name} must hold one entry for each of {count} frames, got {shown(values)}: give a "
            "list"
        )
    return entries


def _check_focal_length(focal_px: Any) -> float | None:
    """Return a checked focal length, or None if there is none. Raises InputError."""
    if focal_px is None:
        return None
    try:
        return check_focal_length(focal_px, "focal_length_px")
    except ValueError as error:
        raise InputError(
            f"{error}: give fx of the camera's matrix, in pixels of the frames, or leave it out"
        ) from error
