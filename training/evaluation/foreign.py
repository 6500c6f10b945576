"""A network of others, wrapped so that it can be scored."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError, SSDNetError
from runtime.contract.canonical_focal import CameraScale, camera_scale
from runtime.contract.contract import NO_CLASS
from runtime.contract.model_file import read_onnx
from runtime.contract.network_size import NetworkSize, network_size
from runtime.contract.resize import Size, resize_nearest
from runtime.engine.inference import at_frame_size
from runtime.engine.preprocess import NetworkInput, preprocess
from runtime.engine.session import describe_error, open_session
from runtime.files.atomic_write import atomic_write
from training.datasets.class_mapping import ClassTable, named_table
from training.evaluation.adapter import (
    Adapter,
    MissingAdapterError,
    channel_axis,
    describe_network,
    find_rgb,
    read_adapter,
)
from training.scores.scoring import HeadMaps

# Grey value of the pixels around a padded frame.
_PADDED = 114
# Least inverse depth [1/m]; smaller ones become 10 km.
_LEAST_INVERSE = 1e-4
_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


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
    adapter: Adapter
    size: NetworkSize = None

    def __post_init__(self) -> None:
        """Check the names, and that the image has one layout and type."""
        wanted = {"rgb": self.adapter.rgb, "sparse_depth": self.adapter.sparse_depth}
        self._require(wanted, [item.name for item in self.session.get_inputs()], "inputs")
        wanted = {"semantic": self.adapter.semantic, "depth": self.adapter.depth}
        self._require(wanted, [item.name for item in self.session.get_outputs()], "outputs")
        fed = {self._rgb.name, self.adapter.sparse_depth}
        if left := [item.name for item in self.session.get_inputs() if item.name not in fed]:
            raise InputError(
                f"{self.path}: its input {left[0]!r} is fed by no key of the adapter: name it as "
                "rgb or sparse_depth"
            )
        if len(self._rgb.shape) != 4 or self._rgb.type not in _TYPES:
            raise InputError(
                f"{self.path}: its input {self._rgb.name!r} is {self._rgb.type} "
                f"{self._rgb.shape}; expected an image of four axes, of {', '.join(_TYPES)}"
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
        frame = preprocess(
            rgb,
            None if self.adapter.sparse_depth is None else sparse_depth,
            size_for=self._size_for,
            scale_for=lambda size: self._scale_for(size, focal_length_px),
        )
        # The engine's treatment of returns after the network does not belong to this network.
        frame = replace(frame, full_size_returns=None)
        canvas, corner = self._canvas(frame.network_size)
        feeds = {self._rgb.name: self._image(frame, canvas, corner)}
        if self.adapter.sparse_depth is not None:
            feeds[self.adapter.sparse_depth] = self._returns(frame, canvas, corner)
        heads = [name for name in (self.adapter.semantic, self.adapter.depth) if name is not None]
        try:
            outputs = dict(zip(heads, self.session.run(heads, feeds), strict=True))
        except Exception as error:
            shape = feeds[self._rgb.name].shape
            raise SSDNetError(
                f"{self.path}: fails on an image {shape}: {describe_error(error)}: set size or "
                "stride in its adapter"
            ) from error
        rows = slice(corner[0], corner[0] + frame.network_size[0])
        columns = slice(corner[1], corner[1] + frame.network_size[1])
        found: dict[str, NDArray[Any]] = {}
        ids = None
        if self.adapter.semantic is not None:
            values = outputs[self.adapter.semantic]
            if self._is_scores(values) and self.adapter.class_stride is None:
                planes = [_enlarge(plane, canvas)[rows, columns] for plane in self._scores(values)]
                ids = _decide([_enlarge(plane, frame.frame_size) for plane in planes])
            else:
                found["semantic"] = np.ascontiguousarray(self._ids(values, canvas)[rows, columns])
        if self.adapter.depth is not None:
            raw = _enlarge(self._plane(outputs[self.adapter.depth], self.adapter.depth), canvas)
            found["depth"] = self._metres(np.ascontiguousarray(raw[rows, columns]))
        answer = HeadMaps(**at_frame_size(found, frame))
        return answer if ids is None else answer.with_semantic(ids)

    @property
    def _rgb(self) -> Any:
        inputs = {item.name: item for item in self.session.get_inputs()}
        return inputs[self.adapter.rgb] if self.adapter.rgb else find_rgb(self.session)

    @property
    def _is_last(self) -> bool:
        """Whether the channels are the last axis."""
        if self.adapter.layout is not None:
            return self.adapter.layout == "NHWC"
        return channel_axis(self._rgb.shape) == 3

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
        rgb = _pad(frame.rgb, canvas, corner, _PADDED)
        values = rgb[..., ::-1] if self.adapter.channels == "BGR" else rgb
        if self.adapter.normalize != "none":
            mean, std = (np.array(item, np.float32) for item in self.adapter.color_scale)
            if self.adapter.channels == "BGR":
                mean, std = mean[::-1], std[::-1]
            values = (values - mean) / std
        values = values if self._is_last else values.transpose(2, 0, 1)
        return np.ascontiguousarray(values[np.newaxis].astype(_TYPES[self._rgb.type]))

    def _returns(self, frame: NetworkInput, canvas: Size, corner: Size) -> NDArray[Any]:
        (fed,) = (i for i in self.session.get_inputs() if i.name == self.adapter.sparse_depth)
        depth = _pad(frame.sparse_depth, canvas, corner, 0) * self.adapter.sparse_depth_scale
        axis = (0,) if len(fed.shape) == 3 else (0, 3 if self._is_last else 1)
        return np.expand_dims(depth, axis).astype(_TYPES.get(fed.type, np.float32))

    def _is_scores(self, values: NDArray[Any]) -> bool:
        if self.adapter.semantic_is is not None:
            return self.adapter.semantic_is == "scores"
        return values.ndim == 4 and min(values.shape[1], values.shape[3]) > 1

    def _scores(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores as (C, h, w)."""
        count = len(self.adapter.names)
        if values.ndim == 4 and values.shape[1] != count and values.shape[3] == count:
            values = values.transpose(0, 3, 1, 2)
        if values.ndim != 4 or values.shape[1] != count:
            raise InputError(
                f"{self.path}: its output {self.adapter.semantic!r} is {values.shape}, and its "
                f"adapter names {count} classes: correct classes or semantic"
            )
        return self._finite(values[0].astype(np.float32), self.adapter.semantic)

    def _ids(self, values: NDArray[Any], canvas: Size) -> NDArray[np.uint8]:
        """Return the ids at the size of the image that is fed."""
        if self._is_scores(values):
            stride = self.adapter.class_stride or 1
            grid = canvas[0] // stride, canvas[1] // stride
            ids = _decide([_enlarge(plane, grid) for plane in self._scores(values)])
        else:
            plane = self._plane(values, self.adapter.semantic)
            if plane.min() < 0 or plane.max() > NO_CLASS:
                raise InputError(
                    f"{self.path}: its output {self.adapter.semantic!r} has values from "
                    f"{plane.min():g} to {plane.max():g}, which are no class ids: correct "
                    "semantic_is or semantic"
                )
            ids = np.rint(plane).astype(np.uint8)
        return ids if ids.shape == canvas else np.asarray(resize_nearest(ids, canvas))

    def _plane(self, values: NDArray[Any], name: str | None) -> NDArray[np.float32]:
        """Return an output that has one plane as (h, w)."""
        plane = values.reshape([side for side in values.shape if side != 1])
        if plane.ndim != 2:
            raise InputError(
                f"{self.path}: its output {name!r} is {values.shape}; expected a map: name another "
                "output"
            )
        return self._finite(plane.astype(np.float32), name)

    def _metres(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        metres = np.maximum(values / np.float32(self.adapter.depth_scale), np.float32(0))
        if self.adapter.depth_is == "inverse":
            metres = np.reciprocal(np.maximum(metres, np.float32(_LEAST_INVERSE)))
        return np.asarray(metres, np.float32)

    def _finite(self, values: NDArray[np.float32], name: str | None) -> NDArray[np.float32]:
        if not np.isfinite(values).all():
            raise SSDNetError(f"{self.path}: its output {name!r} is not finite")
        return values

    def _require(self, wanted: dict[str, str | None], there: Sequence[str], what: str) -> None:
        for key, name in wanted.items():
            if name is not None and name not in there:
                raise InputError(
                    f"{self.path}: has no {name!r}, which its adapter names as {key}; its {what} "
                    f"are {', '.join(there)}"
                )


def open_foreign(
    path: Path,
    adapter: Path | None,
    *,
    provider: str,
    device_id: int,
    threads: int,
    size: NetworkSize,
) -> ForeignNetwork:
    """Open a network of others.

    Args:
        path: an ONNX file; weights in files beside it are read, too.
        adapter: its description; None: the TOML file of the same name beside it.
        provider: see `open_session`, also for device_id and threads.
        device_id: index of the GPU.
        threads: threads of the processor.
        size: see `ForeignNetwork`.

    Raises:
        MissingAdapterError: if there is no description; one to be edited was written to `adapter`.
        InputError: if the description does not fit.
        ContractError, ProviderError: if the file cannot be opened.
    """
    session = open_session(
        read_onnx(path),
        provider=provider,
        device_id=device_id,
        threads=threads,
        weights_folder=str(path.parent),
    )
    described = adapter or path.with_suffix(".toml")
    if not described.is_file():
        text = describe_network(path, session)
        if adapter is None:
            raise MissingAdapterError(
                f"{path}: was not written by ssdnet-export: save the lines above as {described}, "
                "check them, and run the command again",
                text,
            )
        atomic_write(described, text.encode())
        raise MissingAdapterError(
            f"{described}: there was none, and it was written from what {path} says: check it, and "
            "run the command again",
            text,
        )
    return ForeignNetwork(path, session, read_adapter(described), size)


def _pad(values: NDArray[Any], canvas: Size, corner: Size, value: int) -> NDArray[Any]:
    """Place a map in a larger one with a constant value."""
    height, width = values.shape[:2]
    if (height, width) == canvas:
        return values
    padded = np.full((*canvas, *values.shape[2:]), value, values.dtype)
    padded[corner[0] : corner[0] + height, corner[1] : corner[1] + width] = values
    return padded


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
