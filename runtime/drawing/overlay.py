"""One picture of a frame and its predictions."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import ClassInfo, find_sky
from runtime.contract.heads import HEADS, Panel
from runtime.drawing.color_scale import (
    DEPTH_COLORS,
    NO_VALUE_COLOR,
    ColorScale,
    text_width,
    write_text,
)

# Larger frames are shrunk by a whole number until they fit. The side of a JPEG has at most 65500
# pixels.
_PANEL_WIDTH, _PANEL_HEIGHT = 960, 4096
_SCREEN = (1080, 1920)  # rows and columns into which a grid with its legend must fit
_LEGEND_WIDTH = 200  # beside a grid without a free cell
_DOT_SHARE = 180  # a return is a dot of this part of the panel's shorter side
_CLASS_OPACITY = 0.7
_LEGEND_LINE = 22  # pixels
_NO_DEPTH = ClassInfo("no depth", NO_VALUE_COLOR)  # entry of the legend
_NEAREST_M = 3.0  # near end of the colour scale; nothing but the bonnet is nearer
_UNCERTAINTY_PERCENT = (1.0, 100.0)


class Drawable(Protocol):
    """What can be drawn."""

    @property
    def heads(self) -> Mapping[str, NDArray[Any]]:
        """The predictions by the names of their heads, at the picture's size."""


class _Grid(NamedTuple):
    """A grid of panels with its legend: the picture's size, and where the legend stands."""

    height: int
    width: int
    columns: int
    in_cell: bool

    def distance_to_screen(self) -> float:
        """How far the shape is from that of a screen."""
        return abs(math.log(self.width / self.height * _SCREEN[0] / _SCREEN[1]))


class Overlay:
    """Draws a frame and its heads as panels with a legend, by the `panel` of each head.

    The colours of the depth are the same for every frame: logarithmic, from bright (near) to dark
    (far), so that they are readable without hue. The uncertainty is drawn as a share of the depth,
    logarithmic, bright if it is large. Neither is drawn where the class is sky or the depth is not
    above 0.

    Args:
        classes: the classes in the order of their ids.
        max_depth_m: depth of the darkest colour.
    """

    def __init__(self, classes: Sequence[ClassInfo], max_depth_m: float) -> None:
        self._classes = tuple(classes)
        self._sky = find_sky(classes)
        nearest_m = min(_NEAREST_M, max_depth_m / 10)
        self._depth_scale = ColorScale(
            "depth", "m", nearest_m, max_depth_m, DEPTH_COLORS, bright_low=True
        )
        self._share_scale = ColorScale(
            "uncertainty", "%", *_UNCERTAINTY_PERCENT, cv2.COLORMAP_VIRIDIS
        )
        self._legends: dict[tuple[int, tuple[ColorScale, ...]], NDArray[np.uint8]] = {}

    def draw(
        self,
        rgb: NDArray[np.uint8] | None,
        prediction: Drawable,
        returns: NDArray[np.float32] | None = None,
        *,
        widest: int | None = None,
    ) -> NDArray[np.uint8]:
        """Draw one frame for a screen: its panels in a grid, the legend beside them.

        The panels are as large as a screen of 1920 x 1080 pixels permits; the legend stands in a
        free cell of the grid if it fits there.

        Args:
            rgb: uint8 (H, W, 3), RGB; None draws the predictions alone.
            prediction: predictions at the image's size.
            returns: float32 (H, W) [m], 0 or less where there is no return. They are drawn on the
                image, to show whether they lie where they should.
            widest: largest width of a panel, whether or not the grid fits the screen; None: the
                screen decides.

        Returns:
            uint8 (H', W', 3), BGR, as OpenCV writes it.
        """
        height, width = _size(rgb, prediction)
        heads = prediction.heads
        count = (rgb is not None) + sum(HEADS[head].panel is not None for head in heads)
        step = 1 if widest is None else _step(height, width, widest)
        while True:
            size = height // step, width // step
            grids = [self._grid(count, columns, size, heads) for columns in range(1, count + 1)]
            fitting = [each for each in grids if np.less_equal(each[:2], _SCREEN).all()]
            if fitting or widest is not None or 2 * step > min(height, width):
                break
            step += 1
        best = min(fitting or grids, key=_Grid.distance_to_screen)
        panels = self.panels(rgb, prediction, returns, widest=size[1])
        for title, panel in panels.items():
            write_text(panel, title, (6, 16))
        picture = np.zeros((best.height, best.width, 3), np.uint8)
        for index, panel in enumerate(panels.values()):
            _place(picture, panel, divmod(index, best.columns), size)
        legend = self.draw_legend(size[1] if best.in_cell else _LEGEND_WIDTH, heads)
        cell = divmod(count, best.columns) if best.in_cell else (0, best.columns)
        if len(legend):
            _place(picture, legend, cell, size)
        return picture

    def _grid(self, count: int, columns: int, size: tuple[int, int], heads: Iterable[str]) -> _Grid:
        rows = -(-count // columns)
        height, width = rows * size[0], columns * size[1]
        has_cell = count < rows * columns and size[1] >= _LEGEND_WIDTH
        if has_cell and len(self.draw_legend(size[1], heads)) <= size[0]:
            return _Grid(height, width, columns, in_cell=True)
        beside = len(self.draw_legend(_LEGEND_WIDTH, heads))
        width += _LEGEND_WIDTH * (beside > 0)
        return _Grid(max(height, beside), width, columns, in_cell=False)

    def panels(
        self,
        rgb: NDArray[np.uint8] | None,
        prediction: Drawable,
        returns: NDArray[np.float32] | None = None,
        *,
        widest: int | None = None,
    ) -> dict[str, NDArray[np.uint8]]:
        """Draw the panels of `draw` without text, all of one size.

        Args:
            rgb: uint8 (H, W, 3), RGB; None draws the predictions alone.
            prediction: predictions at the image's size.
            returns: see `draw`.
            widest: largest width of a panel; None: 960 pixels.

        Returns:
            The panels by their titles, uint8 (H', W', 3), BGR.
        """
        step = _step(*_size(rgb, prediction), widest)
        image = None if rgb is None else cv2.cvtColor(_shrink(rgb, step), cv2.COLOR_RGB2BGR)
        panels: dict[str, NDArray[Any]] = {} if image is None else {"image": image}
        if image is not None and returns is not None and (returns > 0).any():
            panels = {"image with returns": self._paint_returns(image, returns, step)}
        heads = prediction.heads
        ids = _shrink_nearest(heads["semantic"], step) if "semantic" in heads else None
        depth = _shrink_nearest(heads["depth"], step) if "depth" in heads else None
        sky = None if ids is None or self._sky is None else ids == self._sky
        for kind, head in ((kind, head) for kind in Panel for head in heads):
            if HEADS[head].panel is not kind:
                continue
            if kind is Panel.CLASSES and ids is not None:
                panels["classes"] = self._paint_classes(ids, image)
            elif kind is Panel.DEPTH:
                depth_m = _shrink_nearest(heads[head], step)
                title = head if sky is None else f"{head}, none in the sky"
                panels[title] = self._depth_scale.paint(depth_m, hidden=_hidden(depth_m, sky))
            elif kind is Panel.SHARE_OF_DEPTH and depth is not None:
                percent: NDArray[Any] = 100 * _shrink_nearest(heads[head], step)
                percent = percent / np.maximum(depth, 1e-6)
                panels["uncertainty, % of the depth"] = self._share_scale.paint(
                    percent, hidden=_hidden(depth, sky)
                )
            elif kind is Panel.GRAY:
                gray = cv2.convertScaleAbs(_shrink(heads[head], step), alpha=255)
                panels[head] = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
        return panels

    def draw_depth_bar(self, width: int) -> NDArray[np.uint8]:
        """Draw the colour bar of the depth: uint8 (H', width, 3), BGR."""
        return self._depth_scale.draw_bar(width, _LEGEND_LINE)

    def _paint_returns(
        self, image: NDArray[Any], returns: NDArray[np.float32], step: int
    ) -> NDArray[Any]:
        """Draw each return as a dot in the colour of its depth; the nearest are in front."""
        rows, columns = np.nonzero(returns > 0)
        painted = image.copy()
        places, side = np.stack([columns, rows]) // step, round(min(image.shape[:2]) / _DOT_SHARE)
        self._depth_scale.draw_dots(painted, places, returns[rows, columns], max(1, side))
        return painted

    def _paint_classes(self, ids: NDArray[np.uint8], image: NDArray[Any] | None) -> NDArray[Any]:
        classes = cv2.applyColorMap(ids, self._class_colors)
        if image is None:
            return classes
        return cv2.addWeighted(classes, _CLASS_OPACITY, image, 1 - _CLASS_OPACITY, 0)

    @cached_property
    def _class_colors(self) -> NDArray[np.uint8]:
        colors = np.zeros((256, 1, 3), dtype=np.uint8)
        colors[: len(self._classes), 0] = [info.color[::-1] for info in self._classes]
        return colors

    def draw_legend(self, width: int, heads: Iterable[str]) -> NDArray[np.uint8]:
        """Draw the classes and the colour bars of these heads: uint8 (H', width, 3), BGR."""
        kinds = {HEADS[head].panel for head in heads}
        bars = {Panel.DEPTH: self._depth_scale, Panel.SHARE_OF_DEPTH: self._share_scale}
        scales = tuple(scale for kind, scale in bars.items() if kind in kinds)
        key = width, scales
        if key not in self._legends:
            swatches = (*self._classes, _NO_DEPTH) if scales else self._classes
            lines = _class_lines(swatches, width)
            lines += [scale.draw_bar(width, _LEGEND_LINE) for scale in scales]
            self._legends[key] = np.vstack([np.zeros((0, width, 3), np.uint8), *lines])
        return self._legends[key]


def _size(rgb: NDArray[np.uint8] | None, prediction: Drawable) -> tuple[int, int]:
    """(height, width) of the frame."""
    array = next(iter(prediction.heads.values())) if rgb is None else rgb[..., 0]
    return array.shape[-2], array.shape[-1]


def _step(height: int, width: int, widest: int | None) -> int:
    """The whole number by which a frame is shrunk so that its panels are at most `widest` wide."""
    step = max(-(-width // (widest or _PANEL_WIDTH)), -(-height // _PANEL_HEIGHT))
    return min(step, height, width)  # a very long frame keeps at least one line


def _place(
    picture: NDArray[Any], part: NDArray[Any], cell: tuple[int, int], size: tuple[int, int]
) -> None:
    """Copy a panel or the legend into a cell (row, column) of a grid of cells of `size`."""
    y, x = cell[0] * size[0], cell[1] * size[1]
    picture[y : y + len(part), x : x + part.shape[1]] = part


def _class_lines(swatches: Sequence[ClassInfo], width: int) -> list[NDArray[np.uint8]]:
    """Coloured fields with names, in as many lines as needed."""
    lines: list[NDArray[np.uint8]] = []
    x = width
    for info in swatches:
        needed = 26 + text_width(info.name)
        if x + needed > width:
            lines.append(np.zeros((_LEGEND_LINE, width, 3), dtype=np.uint8))
            x = 6
        cv2.rectangle(lines[-1], (x, 5), (x + 12, 17), info.color[::-1], cv2.FILLED)
        write_text(lines[-1], info.name, (x + 16, 16))
        x += needed
    return lines


def _shrink(image: NDArray[Any], step: int) -> NDArray[np.uint8]:
    """Average blocks of step x step pixels; an incomplete last block is cropped."""
    height, width = image.shape[0] // step, image.shape[1] // step
    whole = image[: height * step, : width * step]
    if step == 1:
        return whole.copy()
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _hidden(depth: NDArray[Any], sky: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return where no depth is drawn: where it is not known, and in the sky."""
    unknown: NDArray[np.bool_] = ~(depth > 0)
    return unknown if sky is None else unknown | sky


def _shrink_nearest(image: NDArray[Any], step: int) -> NDArray[Any]:
    height, width = image.shape[0] // step, image.shape[1] // step
    return np.ascontiguousarray(image[: height * step : step, : width * step : step])
