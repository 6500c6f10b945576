"""Colours for a map of numbers, the colour bar that explains them, and text on pictures."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Colour map of every depth in a picture, bright where it is near.
DEPTH_COLORS = cv2.COLORMAP_MAGMA
NO_VALUE_COLOR = (110, 110, 110)
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_NO_VALUE = 255  # index of "no value" in the colour map
_TICKS = tuple(step * 10.0**power for power in range(-3, 5) for step in (1, 2, 3, 5))


@dataclass(frozen=True)
class ColorScale:
    """A logarithmic colour scale: equal ratios look equally different.

    Attributes:
        title: title of the colour bar.
        unit: unit of the values.
        low: value of the first colour; smaller values have the same colour.
        high: value of the last colour; larger values have the same colour.
        color_map: one of OpenCV's colour maps.
        bright_low: whether the map's last and brightest colour belongs to `low`.
    """

    title: str
    unit: str
    low: float
    high: float
    color_map: int
    bright_low: bool = False

    def paint(
        self, values: NDArray[np.float32], *, hidden: NDArray[np.bool_] | None = None
    ) -> NDArray[np.uint8]:
        """Colour a map (H, W): uint8 (H, W, 3), BGR, NO_VALUE_COLOR where `hidden` is true."""
        logarithms = cv2.log(np.clip(values, self.low, self.high))
        steps = (_NO_VALUE - 1) / math.log(self.high / self.low)
        index = cv2.convertScaleAbs(logarithms, alpha=steps, beta=-steps * math.log(self.low))
        if hidden is not None:
            np.putmask(index, hidden, _NO_VALUE)
        return cv2.applyColorMap(index, self._colors)  # type: ignore[return-value]

    def draw_dots(
        self, picture: NDArray[Any], places: NDArray[Any], values: NDArray[Any], side: int
    ) -> None:
        """Draw values as square dots on a picture, low values in front.

        Args:
            picture: uint8 (H, W, 3), BGR.
            places: integers (2, N), the columns and rows of the values.
            values: float32 (N,).
            side: side of a dot in pixels.
        """
        order = np.argsort(-values)
        colors = self.paint(values[order, np.newaxis])[:, 0]
        # All pixels of a dot in turn, so that a lower dot covers a higher one wholly.
        dot = np.indices((side, side)).reshape(2, 1, -1)[::-1] - side // 2
        columns, rows = (places[:, order, np.newaxis] + dot).reshape(2, -1)
        height, width = picture.shape[:2]
        rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
        picture[rows, columns] = np.repeat(colors, side * side, axis=0)

    @cached_property
    def _colors(self) -> NDArray[np.uint8]:
        """The colours from `low` to `high`, then NO_VALUE_COLOR: uint8 (256, 1, 3), BGR."""
        ramp = np.linspace(0, 255, _NO_VALUE).astype(np.uint8).reshape(-1, 1)
        colors = cv2.applyColorMap(ramp[::-1] if self.bright_low else ramp, self.color_map)
        return np.concatenate([colors, np.full((1, 1, 3), NO_VALUE_COLOR, dtype=np.uint8)])

    def draw_bar(self, width: int, height: int) -> NDArray[np.uint8]:
        """Draw the colours from `low` to `high` with values on them: uint8 (H, W, 3), BGR."""
        bar = np.zeros((height, width, 3), dtype=np.uint8)
        ramp = np.geomspace(self.low, self.high, width, dtype=np.float32)
        bar[3:-3] = self.paint(ramp[np.newaxis])
        end = f"{self.high:g} {self.unit}"
        end_at = width - text_width(end) - 4
        write_text(bar, end, (end_at, height - 6))
        free, title = 0, f"{self.title} "
        for tick in _TICKS:
            if not self.low <= tick < self.high:
                continue
            x = round((width - 1) * math.log(tick / self.low) / math.log(self.high / self.low))
            text = f"{title}{tick:g} {self.unit}"
            if x >= free and x + text_width(text) + 8 < end_at:
                cv2.line(bar, (x, 3), (x, height - 4), (0, 0, 0))
                write_text(bar, text, (x + 3, height - 6))
                free, title = x + text_width(text) + 8, ""
        return bar


def write_text(picture: NDArray[Any], text: str, at: tuple[int, int]) -> None:
    """Write text; `at` is (x, y) of the baseline's left end."""
    x, y = at
    # In some versions of OpenCV thicker letters are wider, so the edges have the same thickness.
    for corner in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
        cv2.putText(picture, text, corner, _FONT, _FONT_SCALE, _BLACK, 1, cv2.LINE_AA)
    cv2.putText(picture, text, at, _FONT, _FONT_SCALE, _WHITE, 1, cv2.LINE_AA)


def text_width(text: str) -> int:
    """Width in pixels of a text that `write_text` draws, without its edges."""
    return int(cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)[0][0])
