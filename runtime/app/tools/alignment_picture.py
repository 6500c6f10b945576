"""The picture of a calibration: returns on the image before and after, with insets at edges."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.checks.view import find_jumps
from runtime.drawing.color_scale import DEPTH_COLORS, ColorScale
from runtime.drawing.picture_text import write_text
from runtime.geometry.calibration import Calibration

_WIDTH = 1280  # of the picture; larger images are shrunk to it
_INSETS = 3
_INSET_SHARE, _ZOOM_DOT = 0.12, 5  # inset height / image height; pixels of a dot in an inset
_DEPTH = ColorScale("depth", "m", 3.0, 80.0, DEPTH_COLORS, bright_low=True)
_GAP, _BAR = 4, 22
_WHITE = (255, 255, 255)

_Picture = NDArray[Any]  # uint8 (H, W, 3), BGR
_Cloud = NDArray[np.float64]


def draw_alignment(
    rgb: NDArray[np.uint8],
    points: NDArray[np.float32],
    calibrations: dict[str, Calibration],
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
    clouds = {title: _on_image(points, each, rgb) for title, each in calibrations.items()}
    *_, last = clouds.values()
    side = max(16, round(_INSET_SHARE * height))
    centres = _edges(last, (height, width), side)
    rows: list[_Picture] = []
    for title, (pixels, _) in clouds.items():
        whole = _dots(_resized(image, _WIDTH), pixels * (_WIDTH / width, _WIDTH / width, 1), 2)
        for number, (x, y) in enumerate(centres, 1):
            corners = np.array([(x - side, y - side // 2), (x + side, y + side // 2)])
            first, second = (tuple(map(int, each * _WIDTH / width)) for each in corners)
            cv2.rectangle(whole, first, second, _WHITE, 1)
            write_text(whole, str(number), (first[0] + 3, first[1] + 13))
        write_text(whole, title, (6, 16))
        insets = [_inset(image, pixels, centre, side) for centre in centres]
        for number, inset in enumerate(insets, 1):
            write_text(inset, f"{number}, {title}", (6, 16))
        rows += [whole, *([_beside(insets)] if insets else [])]
    return np.vstack([*rows, _DEPTH.draw_bar(_WIDTH, _BAR)])


def _on_image(
    points: NDArray[np.float32], calibration: Calibration, rgb: NDArray[np.uint8]
) -> tuple[_Cloud, NDArray[np.bool_]]:
    """Column, row and depth (N, 3) of the returns in the image, far ones first; which are jumps."""
    depth = calibration.project(points, (rgb.shape[0], rgb.shape[1]))
    row, column = np.nonzero(depth)
    order = np.argsort(-depth[row, column])
    row, column = row[order], column[order]
    z = depth[row, column]
    places = np.column_stack([column, row, np.ones(len(row))])
    rays = places @ np.linalg.inv(calibration.intrinsics).T
    found = find_jumps((rays * z[:, None]).astype(np.float32))
    return np.column_stack([column, row, z]).astype(np.float64), found


def _edges(
    cloud: tuple[_Cloud, NDArray[np.bool_]], size: tuple[int, int], side: int
) -> list[tuple[int, int]]:
    """Centres (x, y) of separate parts of the image with the most jumps, from left to right."""
    pixels, is_jump = cloud
    height, width = size
    counts: NDArray[Any] = np.zeros(size, np.float32)
    columns, rows, _ = pixels[is_jump].astype(int).T
    counts[rows, columns] = 1
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


def _inset(image: _Picture, pixels: _Cloud, centre: tuple[int, int], side: int) -> _Picture:
    """An enlarged part of the image, twice as wide as high, with the returns in it."""
    x, y = centre
    left, top = x - side, y - side // 2
    part = image[top : top + side, left : left + 2 * side]
    width = (_WIDTH - (_INSETS - 1) * _GAP) // _INSETS
    scale = width / part.shape[1]
    moved = (pixels - (left, top, 0)) * (scale, scale, 1) + (scale / 2, scale / 2, 0)
    return _dots(_resized(part, width), moved, _ZOOM_DOT)


def _dots(picture: _Picture, pixels: _Cloud, dot: int) -> _Picture:
    """The picture with a dot for each return, in the colour of its depth."""
    colors = _DEPTH.paint(pixels[:, 2:].astype(np.float32))[:, 0]
    height, width = picture.shape[:2]
    for (x, y, _), color in zip(pixels, colors.tolist(), strict=True):
        if 0 <= x < width and 0 <= y < height:
            left, top = round(x) - dot // 2, round(y) - dot // 2
            picture[max(0, top) : top + dot, max(0, left) : left + dot] = color
    return picture


def _beside(insets: list[_Picture]) -> _Picture:
    """The insets in one row, as wide as the picture."""
    row = np.zeros((insets[0].shape[0], _WIDTH, 3), np.uint8)
    for number, inset in enumerate(insets):
        left = number * (inset.shape[1] + _GAP)
        row[:, left : left + inset.shape[1]] = inset
    return row


def _resized(image: _Picture, width: int) -> _Picture:
    height = round(image.shape[0] * width / image.shape[1])
    way = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
    return cv2.resize(image, (width, height), interpolation=way)
