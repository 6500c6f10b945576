"""One picture of a frame and its answers, to look at."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract import ClassInfo

# Larger frames are shrunk by a whole number until they fit: a JPEG side has at most 65500 pixels.
_PANEL_WIDTH, _PANEL_HEIGHT = 640, 4096
_STACK_ASPECT = 2.0  # panels wider than this stand below one another
_CLASS_OPACITY = 0.7
_LEGEND_LINE = 22  # pixels
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_TICKS_M = (0, 2, 5, 10, 20, 30, 40, 60, 80, 100, 150, 200, 300)


class Answers(Protocol):
    """What can be drawn, at the picture's size; None where there is no such head."""

    @property
    def semantic(self) -> NDArray[np.uint8] | None:
        """Class ids (H, W)."""

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """Metres (H, W)."""

    @property
    def boundary(self) -> NDArray[np.float32] | None:
        """Probability (H, W)."""


class Overlay:
    """Draw strips of panels: image, classes, depth, boundary; heads that are missing are left out.

    The depth colours are metric and the same for every frame: they run with the square root of
    the depth from 0 to max_depth_m, so that near things keep more of them. The
    legend below the panels gives classes and metres.
    """

    def __init__(self, classes: Sequence[ClassInfo], max_depth_m: float) -> None:
        self._classes = tuple(classes)
        self._max_depth_m = max_depth_m
        self._legends: dict[int, NDArray[np.uint8]] = {}

    def draw(self, rgb: NDArray[np.uint8], prediction: Answers) -> NDArray[np.uint8]:
        """Draw one frame.

        rgb: uint8 (H, W, 3), red first.
        Returns uint8, blue first, as OpenCV writes it.
        """
        step = max(-(-rgb.shape[1] // _PANEL_WIDTH), -(-rgb.shape[0] // _PANEL_HEIGHT))
        step = min(step, *rgb.shape[:2])  # at least a line of a very long frame is left
        image = cv2.cvtColor(_shrink(rgb, step), cv2.COLOR_RGB2BGR)
        panels = {"image": image}
        if prediction.semantic is not None:
            ids = _shrink_nearest(prediction.semantic, step)
            classes = cv2.applyColorMap(ids, self._class_colors)
            panels["classes"] = cv2.addWeighted(
                classes, _CLASS_OPACITY, image, 1 - _CLASS_OPACITY, 0
            )
        if prediction.depth is not None:
            depth = _shrink_nearest(prediction.depth, step)
            panels["depth"] = cv2.applyColorMap(self._depth_index(depth), self._depth_colors)
        if prediction.boundary is not None:
            boundary = cv2.convertScaleAbs(_shrink(prediction.boundary, step), alpha=255)
            panels["boundary"] = cv2.cvtColor(boundary, cv2.COLOR_GRAY2BGR)
        for title, panel in panels.items():
            _text(panel, title, (6, 16))
        height, width = image.shape[:2]
        join = cv2.vconcat if width >= _STACK_ASPECT * height else cv2.hconcat
        strip = join(list(panels.values()))
        return cv2.vconcat([strip, self._legend(strip.shape[1])])  # type: ignore[return-value]

    def _depth_index(self, depth: NDArray[np.float32]) -> NDArray[np.uint8]:
        scale = 255 / self._max_depth_m**0.5
        return cv2.convertScaleAbs(cv2.sqrt(depth), alpha=scale)  # type: ignore[return-value]

    @cached_property
    def _class_colors(self) -> NDArray[np.uint8]:
        colors = np.zeros((256, 1, 3), dtype=np.uint8)
        for index, info in enumerate(self._classes):
            colors[index, 0] = info.color[::-1]
        return colors

    @cached_property
    def _depth_colors(self) -> NDArray[np.uint8]:
        ramp = np.arange(255, -1, -1, dtype=np.uint8).reshape(-1, 1)  # near is red, far is blue
        return cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO)  # type: ignore[return-value]

    def _legend(self, width: int) -> NDArray[np.uint8]:
        if width not in self._legends:
            self._legends[width] = np.vstack([*self._class_lines(width), self._depth_line(width)])
        return self._legends[width]

    def _class_lines(self, width: int) -> list[NDArray[np.uint8]]:
        """Swatches with names, in as many lines as they need."""
        lines: list[NDArray[np.uint8]] = []
        x = width
        for info in self._classes:
            needed = 26 + _text_width(info.name)
            if x + needed > width:
                lines.append(np.zeros((_LEGEND_LINE, width, 3), dtype=np.uint8))
                x = 6
            cv2.rectangle(lines[-1], (x, 5), (x + 12, 17), info.color[::-1], cv2.FILLED)
            _text(lines[-1], info.name, (x + 16, 16))
            x += needed
        return lines

    def _depth_line(self, width: int) -> NDArray[np.uint8]:
        """The colour scale with metres written on it."""
        line = np.zeros((_LEGEND_LINE, width, 3), dtype=np.uint8)
        ramp = np.linspace(0, 255, width).astype(np.uint8).reshape(1, -1)
        line[3:-3] = cv2.applyColorMap(ramp, self._depth_colors)
        free = 0
        for tick_m in _TICKS_M:
            x = round((width - 1) * (tick_m / self._max_depth_m) ** 0.5)
            text = f"{tick_m} m"
            if x >= free and x + _text_width(text) + 4 < width:
                cv2.line(line, (x, 3), (x, _LEGEND_LINE - 4), _BLACK)
                _text(line, text, (x + 3, 16))
                free = x + _text_width(text) + 8
        return line


def _shrink(image: NDArray[Any], step: int) -> NDArray[np.uint8]:
    """Average blocks of step x step pixels; the few beyond the last whole block are left out."""
    height, width = image.shape[0] // step, image.shape[1] // step
    whole = image[: height * step, : width * step]
    if step == 1:
        return whole.copy()
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _shrink_nearest(image: NDArray[Any], step: int) -> NDArray[Any]:
    height, width = image.shape[0] // step, image.shape[1] // step
    return np.ascontiguousarray(image[: height * step : step, : width * step : step])


def _text(image: NDArray[Any], text: str, at: tuple[int, int]) -> None:
    """Write white on black edges; `at` is (x, y) of the baseline's left end."""
    cv2.putText(image, text, at, _FONT, _FONT_SCALE, _BLACK, 3, cv2.LINE_AA)
    cv2.putText(image, text, at, _FONT, _FONT_SCALE, _WHITE, 1, cv2.LINE_AA)


def _text_width(text: str) -> int:
    return int(cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)[0][0])
