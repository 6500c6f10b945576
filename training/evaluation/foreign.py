"""A network of others, wrapped so that it can be scored."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from runtime.base.arrays import Size
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.canonical_focal import CameraScale, camera_scale
from runtime.contract.contract import NO_CLASS
from runtime.contract.model_file import read_onnx
from runtime.contract.network_size import NetworkSize, check_network_size, network_size
from runtime.contract.resize import resize_nearest
from runtime.engine.inference import at_frame_size
from runtime.engine.preprocess import NetworkInput, preprocess
from runtime.engine.session import describe_error, open_session
from runtime.files.atomic_write import atomic_write
from training.datasets.class_mapping import ClassTable, named_table
from training.evaluation import adapter as adapters
from training.scores.scoring import HeadMaps

# Grey value of the pixels around a padded frame.
_PADDED = 114
# Least inverse depth [1/m]; smaller ones become 10 km.
_LEAST_INVERSE = 1e-4
_DEPTH_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True)
class ForeignNetwork:
    """A session of ONNX Runtime with an adapter; calls answer a frame, see `Predict`.

    Attributes:
        path: path of the file, for messages.
        session: session of ONNX Runtime.
        adapter: the meaning of inputs and outputs.
        size: size to which frames are resized if neither the file nor the adapter fixes it.
    """

    path: Path
    session: Any
    adapter: adapters.Adapter
    size: NetworkSize = None

    def __post_init__(self) -> None:
        """Check the names, the inputs, and that every key and --size can be used."""
        inputs, outputs = self.session.get_inputs(), self.session.get_outputs()
        for key, what, items in (
            ("rgb", "inputs", inputs),
            ("sparse_depth", "inputs", inputs),
            ("semantic", "outputs", outputs),
            ("depth", "outputs", outputs),
        ):
            name, there = getattr(self.adapter, key), [item.name for item in items]
            if name is not None and name not in there:
                raise InputError(
                    f"{self.path}: has no {name!r}, which its adapter names as {key}; its {what} "
                    f"are {', '.join(there)}"
                )
        fed = {self._rgb.name, self.adapter.sparse_depth}
        if left := [item.name for item in inputs if item.name not in fed]:
            raise InputError(
                f"{self.path}: its input {left[0]!r} is fed by no key of the adapter: name it as "
                "rgb or sparse_depth"
            )
        self._require_keys()
        if self._takes_bytes and self.adapter.normalize != "none":
            text = f"warning: {self.path}: takes bytes (uint8), which no normalisation can change: "
            text += f"normalize = {self.adapter.normalize!r} is not applied: leave it out"
            tqdm.write(text, file=sys.stderr)
        check_network_size(self.size, fixed=self._fixed is not None)

    def _require_keys(self) -> None:
        """Raise InputError for a key of the adapter that the file does not allow."""
        adapter, rgb, is_fixed = self.adapter, self._rgb, self._fixed is not None
        axis = adapters.channel_axis(rgb.shape)
        wrong = {
            "layout": axis is not None and self._is_last != (axis == 3),
            "size": adapter.size is not None and is_fixed and self._fixed != adapter.size,
            "stride": adapter.stride > 1 and is_fixed,
            "fit": adapter.fit == "pad" and not is_fixed,
        }
        if key := next((key for key, is_wrong in wrong.items() if is_wrong), None):
            raise InputError(
                f"{self.path}: {key} = {getattr(adapter, key)!r} cannot be used, as its input "
                f"{rgb.name!r} is {rgb.type} {list(rgb.shape)}: leave it out of the adapter"
            )
        if (item := self._lidar) is not None and (
            item.type not in _DEPTH_TYPES
            or len(item.shape) not in (3, 4)
            or (len(item.shape) == 4 and 1 not in item.shape[1:])
        ):
            raise InputError(
                f"{self.path}: its input {item.name!r} is {item.type} {list(item.shape)}; "
                "expected a map of LiDAR depth, of floats: export it so"
            )

    @property
    def table(self) -> ClassTable:
        """The classes; () if there are none."""
        return () if self.adapter.semantic is None else named_table(self.adapter.classes)

    def __call__(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        focal_length_px: float | None,
    ) -> HeadMaps:
        """Answer a frame, see `Predict`."""
        adapter, lidar = self.adapter, self._lidar
        frame = preprocess(
            rgb,
            None if lidar is None else sparse_depth,
            size_for=self._size_for,
            scale_for=lambda size: self._scale_for(size, focal_length_px),
        )
        # The engine's treatment of returns after the network does not belong to this network.
        frame = replace(frame, full_size_returns=None)
        canvas, corner = self._canvas(frame.network_size)
        feeds = {self._rgb.name: self._image(frame, canvas, corner)}
        if lidar is not None:
            feeds[lidar.name] = self._returns(frame, canvas, corner)
        heads = [name for name in (adapter.semantic, adapter.depth) if name is not None]
        try:
            outputs = dict(zip(heads, self.session.run(heads, feeds), strict=True))
        except Exception as error:
            advice = (
                "run the file on its own" if self._fixed else "set size or stride in its adapter"
            )
            raise SSDNetError(
                f"{self.path}: fails on an image {feeds[self._rgb.name].shape}: "
                f"{describe_error(error)}: {advice}"
            ) from error
        for name, values in outputs.items():
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub":
                raise InputError(f"{self.path}: its output {name!r} holds no numbers: name another")
        rows = slice(corner[0], corner[0] + frame.network_size[0])
        columns = slice(corner[1], corner[1] + frame.network_size[1])
        found: dict[str, NDArray[Any]] = {}
        scores: list[NDArray[np.float32]] = []
        if adapter.semantic is not None:
            values = outputs[adapter.semantic]
            if self._is_scores(values) and adapter.class_stride is None:
                scores = [
                    _enlarge(_enlarge(plane, canvas)[rows, columns], frame.frame_size)
                    for plane in self._scores(values, canvas)
                ]
            else:
                found["semantic"] = np.ascontiguousarray(self._ids(values, canvas)[rows, columns])
        if adapter.depth is not None:
            raw = self._plane(outputs[adapter.depth], adapter.depth, canvas)
            raw = _enlarge(raw, canvas)[rows, columns]
            found["depth"] = self._metres(np.ascontiguousarray(raw))
        answer = HeadMaps(**at_frame_size(found, frame))
        return answer.with_semantic(_decide(scores)) if scores else answer

    @property
    def _rgb(self) -> Any:
        return adapters.find_rgb(self.path, self.session, self.adapter.rgb)

    @property
    def _lidar(self) -> Any:
        """The input of the LiDAR depth; None if there is none."""
        inputs = self.session.get_inputs()
        return next((item for item in inputs if item.name == self.adapter.sparse_depth), None)

    @property
    def _takes_bytes(self) -> bool:
        return bool(self._rgb.type == "tensor(uint8)")

    @property
    def _is_last(self) -> bool:
        """Whether the channels are the last axis."""
        if self.adapter.layout is not None:
            return self.adapter.layout == "NHWC"
        return adapters.channel_axis(self._rgb.shape) == 3

    @property
    def _fixed(self) -> Size | None:
        """(height, width) of the input; None if it is free."""
        sides = self._rgb.shape[1:3] if self._is_last else self._rgb.shape[2:4]
        if all(isinstance(side, int) for side in sides):
            return sides[0], sides[1]
        return self.adapter.size if isinstance(self.adapter.size, tuple) else None

    def _size_for(self, frame: Size) -> Size:
        if self._fixed is None:
            return network_size(self.adapter.size or self.size, frame, trained_height=None)
        if self.adapter.fit == "stretch":
            return self._fixed
        scale = min(ours / its for ours, its in zip(self._fixed, frame, strict=True))
        return round(frame[0] * scale), round(frame[1] * scale)

    def _scale_for(self, frame: Size, focal_length_px: float | None) -> CameraScale:
        return camera_scale(
            self.adapter.max_depth_m,
            self.adapter.canonical_focal_px,
            focal_length_px,
            frame_size=frame,
            network_size=self._size_for(frame),
        )

    def _canvas(self, size: Size) -> tuple[Size, Size]:
        """Return the size of the image that is fed, and the corner of the frame in it."""
        if self._fixed is None:
            stride = self.adapter.stride
            return (-(-size[0] // stride) * stride, -(-size[1] // stride) * stride), (0, 0)
        rows, columns = self._fixed[0] - size[0], self._fixed[1] - size[1]
        return self._fixed, (rows // 2, columns // 2)

    def _image(self, frame: NetworkInput, canvas: Size, corner: Size) -> NDArray[Any]:
        values: NDArray[Any] = _pad(frame.rgb, canvas, corner, _PADDED)
        if self.adapter.normalize != "none" and not self._takes_bytes:
            mean, std = (np.array(item, np.float32) for item in self.adapter.color_scale)
            values = (values - mean) / std
        values = values[..., ::-1] if self.adapter.channels == "BGR" else values
        values = values if self._is_last else values.transpose(2, 0, 1)
        return np.ascontiguousarray(values[np.newaxis].astype(adapters.IMAGE_TYPES[self._rgb.type]))

    def _returns(self, frame: NetworkInput, canvas: Size, corner: Size) -> NDArray[Any]:
        depth = _pad(frame.sparse_depth, canvas, corner, 0) * self.adapter.sparse_depth_scale
        axis = (0,) if len(self._lidar.shape) == 3 else (0, 3 if self._is_last else 1)
        return np.expand_dims(depth, axis).astype(_DEPTH_TYPES[self._lidar.type])

    def _is_scores(self, values: NDArray[Any]) -> bool:
        if self.adapter.semantic_is is not None:
            return self.adapter.semantic_is == "scores"
        return values.ndim == 4 and min(values.shape[1], values.shape[3]) > 1

    def _scores(self, values: NDArray[Any], canvas: Size) -> NDArray[np.float32]:
        """Return the scores as (C, h, w)."""
        count = len(self.adapter.names)
        if values.ndim == 4 and values.shape[1] != count and values.shape[3] == count:
            values = values.transpose(0, 3, 1, 2)
        if values.ndim != 4 or values.shape[:2] != (1, count):
            raise InputError(
                f"{self.path}: its output {self.adapter.semantic!r} is {values.shape}, and its "
                f"adapter names {count} classes: correct classes or semantic"
            )
        return self._checked(values[0], values.shape, self.adapter.semantic, canvas)

    def _ids(self, values: NDArray[Any], canvas: Size) -> NDArray[np.uint8]:
        """Return the ids at the size of the image that is fed."""
        if self._is_scores(values):
            stride = self.adapter.class_stride or 1
            grid = canvas[0] // stride, canvas[1] // stride
            ids = _decide([_enlarge(plane, grid) for plane in self._scores(values, canvas)])
        else:
            plane = self._plane(values, self.adapter.semantic, canvas)
            ids = np.clip(np.rint(plane), 0, NO_CLASS).astype(np.uint8)
            if (ids != plane).any():
                raise InputError(
                    f"{self.path}: its output {self.adapter.semantic!r} has values from "
                    f"{plane.min():g} to {plane.max():g}, which are no class ids: name another "
                    f"output; {adapters.ONE_PLANE}"
                )
        return ids if ids.shape == canvas else np.asarray(resize_nearest(ids, canvas))

    def _plane(self, values: NDArray[Any], name: str | None, canvas: Size) -> NDArray[np.float32]:
        """Return an output that has one plane as (h, w)."""
        plane = values.reshape([side for side in values.shape if side != 1])
        if plane.ndim != 2:
            raise InputError(
                f"{self.path}: its output {name!r} is {values.shape}; expected a map: name another "
                "output"
            )
        return self._checked(plane, values.shape, name, canvas)

    def _checked(
        self, maps: NDArray[Any], shape: Sequence[int], name: str | None, canvas: Size
    ) -> NDArray[np.float32]:
        """Return maps (..., h, w) of the output `name` if they are finite and of the image."""
        if not adapters.fits(maps.shape[-2:], canvas):
            raise InputError(
                f"{self.path}: its output {name!r} is {tuple(shape)}, which is no map of the image "
                f"of {canvas[0]} x {canvas[1]}: export rows and columns as its last axes, and "
                "scores as (1, classes, rows, columns)"
            )
        if not np.isfinite(maps := maps.astype(np.float32)).all():
            raise SSDNetError(f"{self.path}: its output {name!r} is not finite")
        return maps

    def _metres(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        metres = np.maximum(values / np.float32(self.adapter.depth_scale), np.float32(0))
        if self.adapter.depth_is == "inverse":
            metres = np.reciprocal(np.maximum(metres, np.float32(_LEAST_INVERSE)))
        return np.asarray(metres, np.float32)


def open_foreign(
    path: Path, adapter: Path | None, place: torch.device, threads: int, size: NetworkSize
) -> ForeignNetwork:
    """Open a network of others.

    Args:
        path: an ONNX file; weights in files beside it are read, too.
        adapter: its description; None: the TOML file of the same name beside it.
        place: the processor or the GPU.
        threads: threads of the processor.
        size: see `ForeignNetwork`.

    Raises:
        MissingAdapterError: if there is no description; one to be edited was written to `adapter`.
        InputError: if the description does not fit.
        ContractError, ProviderError: if the file cannot be opened.
    """
    session = open_session(
        read_onnx(path),
        provider=place.type,
        device_id=place.index or 0,
        threads=threads,
        weights_folder=str(path.parent),
    )
    described = adapter or path.with_suffix(".toml")
    if not described.is_file():
        text = adapters.describe_network(path, session)
        if adapter is None:
            raise adapters.MissingAdapterError(
                f"{path}: was not written by ssdnet-export: save the lines above as {described}, "
                "check them, and run the command again",
                text,
            )
        atomic_write(described, text.encode())
        raise adapters.MissingAdapterError(
            f"{described}: there was none, and it was written from what {path} says: check it, and "
            "run the command again",
            text,
        )
    return ForeignNetwork(path, session, adapters.read_adapter(described), size)


def _pad(values: NDArray[Any], canvas: Size, corner: Size, value: int) -> NDArray[Any]:
    """Place a map in a larger one with a constant value."""
    (top, left), (height, width) = corner, values.shape[:2]
    sides = top, canvas[0] - height - top, left, canvas[1] - width - left
    return np.asarray(
        cv2.copyMakeBorder(values, *sides, cv2.BORDER_CONSTANT, value=(value, value, value))
    )


def _enlarge(plane: NDArray[np.float32], size: Size) -> NDArray[np.float32]:
    """Interpolate a plane bilinearly between the centres of its pixels."""
    if plane.shape == size:
        return plane
    resized = cv2.resize(np.ascontiguousarray(plane), size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(resized)


def _decide(planes: Sequence[NDArray[np.float32]]) -> NDArray[np.uint8]:
    """Return the class with the largest score; ties keep the first class."""
    ids = np.zeros(planes[0].shape, np.uint8)
    best = planes[0].copy()
    for index, plane in enumerate(planes[1:], start=1):
        ids[plane > best] = index
        np.maximum(best, plane, out=best)
    return ids
