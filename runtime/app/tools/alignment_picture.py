"""The picture of a calibration: returns on the image before and after, with insets at edges."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.checks.view import find_jumps
from runtime.drawing.color_scale import DEPTH_COLORS, ColorScale, write_text
from runtime.geometry.calibration import Calibration

_WIDTH = 1280  # of the picture; larger images are shrunk to it
_INSETS, _GAP = 3, 4
_INSET_WIDTH = (_WIDTH - (_INSETS - 1) * _GAP) // _INSETS
_INSET_SHARE = 0.12  # inset height / image height
_DOT, _ZOOM_DOT = 2, 5  # pixels of a return on the image and in an inset
_DEPTH = ColorScale("depth", "m", 3.0, 80.0, DEPTH_COLORS, bright_low=True)
_BAR = 22
_WHITE = (255, 255, 255)

_Picture = NDArray[Any]  # uint8 (H, W, 3), BGR
_Depth = NDArray[np.float32]  # (H, W), metres, 0 where there is no return
_Box = tuple[int, int, int, int]  # left, top, right, bottom


def draw_alignment(
    rgb: NDArray[np.uint8], points: NDArray[np.float32], calibrations: dict[str, Calibration]
) -> _Picture:
    """Draw the returns of a scan on its image, once for each calibration.

    Below each image, the parts around the objects with the most jumps of the scan are enlarged. The
    parts are the same for all calibrations.

    Args:
        rgb: uint8 (H, W, 3), RGB.
        points: float32 (N, 3) or wider, metres, LiDAR frame.
        calibrations: the calibrations by their titles.

    Returns:
        uint8 (H', W', 3), BGR.
    """
    image = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    height, width = image.shape[:2]
    depths = {title: each.project(points, (height, width)) for title, each in calibrations.items()}
    side = max(16, round(_INSET_SHARE * height))
    *_, last = calibrations
    centres = _edges(depths[last], calibrations[last], side)
    rows: list[_Picture] = []
    for title, depth in depths.items():
        whole = _part(image, depth, (0, 0, width, height), _WIDTH, _DOT)
        insets = np.zeros((_INSET_WIDTH // 2 if centres else 0, _WIDTH, 3), np.uint8)
        for number, (x, y) in enumerate(centres):
            box = x - side, y - side // 2, x + side, y - side // 2 + side
            left, top, right, bottom = (int(each * _WIDTH / width) for each in box)
            cv2.rectangle(whole, (left, top), (right, bottom), _WHITE, 1)
            write_text(whole, str(number + 1), (left + 3, top + 13))
            inset = _part(image, depth, box, _INSET_WIDTH, _ZOOM_DOT)
            write_text(inset, f"{number + 1}, {title}", (6, 16))
            at = number * (_INSET_WIDTH + _GAP)
            insets[:, at : at + _INSET_WIDTH] = inset
        write_text(whole, title, (6, 16))
        rows += [whole, insets]
    return np.vstack([*rows, _DEPTH.draw_bar(_WIDTH, _BAR)])


def _edges(depth: _Depth, calibration: Calibration, side: int) -> list[tuple[int, int]]:
    """Centres (x, y) of separate parts of the image with the most jumps, from left to right."""
    height, width = depth.shape
    row, column = np.nonzero(depth)
    places = np.column_stack([column, row, np.ones(len(row))])
    rays = places @ np.linalg.inv(calibration.intrinsics).T
    is_jump = find_jumps((rays * depth[row, column, np.newaxis]).astype(np.float32))
    counts: NDArray[Any] = np.zeros_like(depth)
    counts[row[is_jump], column[is_jump]] = 1
    counts = cv2.blur(counts, (side, side), borderType=cv2.BORDER_CONSTANT)
    counts[: side // 2] = counts[height - side // 2 :] = 0
    counts[:, :side] = counts[:, width - side :] = 0
    centres = []
    for _ in range(_INSETS):
        y, x = np.unravel_index(int(counts.argmax()), counts.shape)
        if counts[y, x] <= 0:
            break
        centres.append((int(x), int(y)))
        counts[:, max(0, x - 2 * side) : x + 2 * side] = 0
    return sorted(centres)


def _part(image: _Picture, depth: _Depth, box: _Box, width: int, dot: int) -> _Picture:
    """A part (left, top, right, bottom) of the image at this width, with the returns in it."""
    left, top, right, bottom = box
    part, depth = image[top:bottom, left:right], depth[top:bottom, left:right]
    scale = width / part.shape[1]
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    picture: _Picture = cv2.resize(part, (width, round(part.shape[0] * scale)), interpolation=way)
    rows, columns = np.nonzero(depth)
    places = np.rint((np.stack([columns, rows]) + 0.5) * scale - 0.5).astype(int)
    _DEPTH.draw_dots(picture, places, depth[rows, columns], dot)
    return picture
