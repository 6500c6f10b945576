"""White text with black edges, legible on any picture."""

from typing import Any

import cv2
from numpy.typing import NDArray

_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)


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
