"""The table of readings: what a recording may mean instead of what it says.

A row says what may be so and what to change, and yields the views of a frame if it is so: one, or
several members of a family, such as scales of a focal length. A row that yields none makes no sense
for the frame. The usual rows stand before the exotic ones: of equal effects the first counts.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from runtime.base.arrays import Float64
from runtime.checks.finding import Severity
from runtime.checks.fit import fit_of, turned
from runtime.checks.view import LEFT_HALF, UPSIDE_DOWN, Answer, View
from runtime.geometry.lens import PLUMB_BOB, Lens

_Matrix = Float64
Views = Iterator[tuple[str, View]]  # by member; "" is the only one
_Matrices = Iterable[tuple[str, _Matrix]]

# From the axes of a LiDAR or vehicle (x ahead, y left, z up) to those of a camera.
_TO_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
# Offset of the principal point, as a share of the image's side. KITTI, PandaSet and View-of-Delft
# have at most 0.04.
_OFF_CENTRE = 0.08
_HALF_CENTRE = 0.35  # of a calibration of half an image: the principal point is left of this
_FAR_M = 3.0  # a position beyond this may have another unit
_ALIKE_COSINE = math.cos(math.radians(20))
_MOST_POINTS = 30_000  # of a scan all around, where nearly all returns move
_LENS_SCALES, _USUAL_K1 = (0.0, 0.5, 1.3), (-0.3, -0.15, 0.15)
_FOCAL_SCALES = (0.6, 0.7, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6)
_BASELINES_M = (-0.54, -0.24, -0.12, 0.12, 0.24, 0.54)
_AHEAD_M = (-2.0, -1.0, 1.0, 2.0)
_DEPTH_SCALES = (1, 100, 256, 1000)  # for metres, centimetres, KITTI's units and millimetres
_FOCAL_RATIO = 10  # a wrong focal length explains at most this ratio


@dataclass(frozen=True)
class Reading:
    """A row of the table.

    Attributes:
        name: name of the row.
        says: what seems to be so, and what to change; {} is the member that fits best.
        views: the views of a frame if it is so.
        figures: what {} of `says` is instead, from the views as given.
        floor: least gain of the score over the view as given.
        is_far: whether nearly all returns move, so that it cannot win where they fit as given.
        changes_image: whether it asks for the answer to another image.
        severity: what follows if it wins.
    """

    name: str
    says: str
    views: Callable[[View], Views]
    figures: Callable[[Sequence[View]], str] | None = None
    floor: float = 0.1
    is_far: bool = True
    changes_image: bool = False
    severity: Severity = Severity.FAULT

    def told(self, member: str, views: Sequence[View]) -> str:
        """The row in words."""
        return self.says.format(member if self.figures is None else self.figures(views))


def _of_matrix(change: Callable[[_Matrix], _Matrices]) -> Callable[[View], Views]:
    """The views with changed extrinsics; a depth map has none."""

    def views(view: View) -> Views:
        if not view.is_map:
            points = view.points[:: len(view.points) // _MOST_POINTS + 1]
            for member, extrinsics in change(view.extrinsics):
                if not _is_alike(extrinsics, view.extrinsics):
                    yield member, replace(view, points=points, extrinsics=extrinsics)

    return views


def _is_alike(first: _Matrix, second: _Matrix) -> bool:
    """Whether two extrinsics differ by so little that a search for the rotation compares them."""
    cosine = (np.trace(first[:3, :3] @ second[:3, :3].T) - 1) / 2
    return bool(cosine > _ALIKE_COSINE and np.abs(first[:3, 3] - second[:3, 3]).max() < 1)


def _transposed(given: _Matrix) -> _Matrices:
    mixed = given.copy()
    mixed[:3, :3] = given[:3, :3].T
    yield "", mixed


def _swapped(given: _Matrix) -> _Matrices:
    for turn in (_TO_CAMERA, _TO_CAMERA.T):
        yield "turn the result of the matrix", turn @ given
        yield "turn the points first", given @ turn
        yield "and the matrix to be camera to LiDAR", turn @ np.linalg.inv(given)


def _turned(given: _Matrix) -> _Matrices:
    for name, first, second in (("x", 1, 2), ("y", 0, 2), ("z", 0, 1)):
        quarter = np.eye(4)
        quarter[first], quarter[second] = -np.eye(4)[second], np.eye(4)[first]
        for count in (2, 1, 3):
            turn = np.linalg.matrix_power(quarter, count)
            yield f"{90 * count} degrees about its {name} axis", given @ turn


def _other_units(given: _Matrix) -> _Matrices:
    for units, name in ((100, "centimetres"), (1000, "millimetres")):
        if np.abs(given[:3, 3]).max() > _FAR_M:
            metres = given.copy()
            metres[:3, 3] /= units
            yield f"{name}: divide it by {units}", metres


def _camera(view: View, *, focal: float = 1, centre: float = 1, shift: Any = (0, 0)) -> _Matrix:
    """The intrinsics with a scaled focal length, and a scaled, then shifted principal point."""
    intrinsics = view.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= focal
    intrinsics[:2, 2] = intrinsics[:2, 2] * centre + shift
    return intrinsics


def _another_size(view: View) -> Views:
    (_, width), (x, y) = view.size, view.intrinsics[:2, 2]
    if min(x, y) > 0 and abs(x / width - 0.5) >= _OFF_CENTRE:
        scale = width / (2 * x)
        matrix = _camera(view, focal=scale, centre=scale)
        yield f"{scale:.2g}", replace(view, intrinsics=matrix)


def _cut_images(view: View) -> Views:
    (height, width), (x, y) = view.size, view.intrinsics[:2, 2]
    left, up = max(2 * x - width, 0) / 2, 2 * y - height
    if min(x, y) > 0 and up >= 2 * _OFF_CENTRE * height:
        for part in (1, 0.5):  # cut at the top, like KITTI's images for depth completion, or around
            matrix = _camera(view, shift=(-left, -part * up))
            member = f"{left:.0f} px farther left and {part * up:.0f} px farther up"
            yield member, replace(view, intrinsics=matrix)


def _exchanged(view: View) -> Views:
    (_, width), (x, y) = view.size, view.intrinsics[:2, 2]
    if abs(y / width - 0.5) < min(abs(x / width - 0.5), _OFF_CENTRE):
        yield "", replace(view, intrinsics=_camera(view, shift=(y - x, x - y)))


def _flipped(way: tuple[slice, ...], view: View) -> Views:
    answer = view.answer
    yield "", view.near(answer=Answer(answer.boundary[way], answer.log_depth[way]))


def _changed_image(change: str, view: View) -> Views:
    if change == LEFT_HALF and view.intrinsics[0, 2] > _HALF_CENTRE * view.size[1]:
        return  # the calibration is that of the whole image
    if (answer := view.others(change)) is not None:
        share = answer.log_depth.shape[1] / view.answer.log_depth.shape[1]
        yield "", replace(view, answer=answer, size=(view.size[0], round(share * view.size[1])))


def _scaled(view: View) -> Views:
    yield "", replace(view, points=view.points * np.float32(math.exp(-fit_of(view).log_ratio)))


def _ratio(views: Sequence[View]) -> str:
    """The ratio of returns to predicted depth, and the unit or focal length that would fit."""
    view, ratio = views[0], math.exp(float(np.median([fit_of(each).log_ratio for each in views])))
    what = "check their unit"
    if view.depth_scale is not None:
        wanted = view.depth_scale * ratio
        usual = min(_DEPTH_SCALES, key=lambda each: abs(math.log(each / wanted)))
        what = f"try `depth_scale=` of about {rounded(wanted)}"
        if 0.5 < usual / wanted < 2:
            what = f"try `depth_scale={usual}`"
    if view.focal_px is not None and 1 / _FOCAL_RATIO < ratio < _FOCAL_RATIO:
        fits = rounded(view.focal_px * ratio)
        what += f", or check the focal length of {view.focal_px:g} px: about {fits} would fit"
    return f"{rounded(ratio)} times as far as the depth predicted from the image: {what}"


def rounded(value: float) -> str:
    """A number with two digits."""
    return f"{float(f'{value:.2g}'):g}"


def _inverse_depth(view: View) -> Views:
    if view.is_map:  # in any unit
        yield from _scaled(replace(view, points=view.points / view.points[:, 2:] ** 2))


def _along_ray(view: View) -> Views:
    if view.is_map:
        z, ranges = view.points[:, 2:], np.linalg.norm(view.points, axis=1)[:, None]
        yield "", replace(view, points=view.points * z / ranges)


def _other_lens(view: View) -> Views:
    lens = view.lens
    for each in _LENS_SCALES if lens else _USUAL_K1:
        if lens is None:
            yield f"k1 of about {each:g}", view.near(lens=Lens.of(PLUMB_BOB, (each, 0, 0, 0)))
        else:
            scaled = replace(lens, coefficients=tuple(each * one for one in lens.coefficients))
            yield f"{each:g} times the coefficients", view.near(lens=scaled if each else None)


def _other_focal(view: View, *, of_map: bool) -> Views:
    for scale in _FOCAL_SCALES if view.is_map == of_map else ():
        told = 1 / scale if of_map else scale  # of a depth camera: its own focal length
        yield f"{told:.2g}", view.near(intrinsics=_camera(view, focal=scale))


def _moved(view: View, axis: int, distances_m: Sequence[float], words: tuple[str, str]) -> Views:
    """The LiDAR moved along an axis of the camera, in words for + and -."""
    for metres in distances_m:
        moved = view.extrinsics.copy()
        moved[axis, 3] += metres
        yield f"{abs(metres):g} m {words[metres < 0]}", view.near(extrinsics=moved)


def _turned_a_little(view: View) -> Views:
    for axis, name in enumerate(("yaw", "pitch")):
        for degrees in (-3, -2, -1, 1, 2, 3):
            unit = "degrees" if abs(degrees) > 1 else "degree"
            yield f"{degrees:+g} {unit} of {name}", turned(view, degrees * np.eye(3)[axis])


def _other_time(view: View) -> Views:
    for when, points in view.beside.items():
        yield when, replace(view, points=points)


_BETTER = "the returns fit the images better "
_SMALL: dict[str, Any] = {"floor": 0.06, "is_far": False, "severity": Severity.WARNING}
_TOML = "in a TOML file for `calibration=`"

READINGS = (
    Reading(
        "other_time",
        "scans of {} fit the images better than their own: check the time stamps, or the names of "
        "the files",
        _other_time,
        floor=0.06,
        is_far=False,
    ),
    Reading("turned", _BETTER + "turned by {}: run ssdnet-calibrate", _turned_a_little, **_SMALL),
    Reading(
        "inverse_extrinsics",
        "the matrix seems to be camera to LiDAR: take its inverse",
        _of_matrix(lambda given: [("", np.asarray(np.linalg.inv(given), np.float64))]),
    ),
    Reading(
        "transposed_rotation",
        "its rotation seems to be camera to LiDAR: transpose it",
        _of_matrix(_transposed),
    ),
    Reading(
        "points_in_camera",
        'the points seem to be in the camera\'s frame already: give points_in = "camera" instead '
        f"of extrinsics, {_TOML}",
        _of_matrix(lambda _: [("", np.eye(4))]),
    ),
    Reading(
        "swapped_axes",
        "the axes of camera (z ahead) and LiDAR (x ahead, z up) seem to be swapped: {}",
        _of_matrix(_swapped),
    ),
    Reading("turned_lidar", "the LiDAR seems to be turned by {}", _of_matrix(_turned)),
    Reading("position_units", "its position seems to be in {}", _of_matrix(_other_units)),
    Reading(
        "image_size",
        "the calibration seems to be for images of another size: use images of the calibrated "
        "size, or multiply the first two rows of the intrinsics by the ratio of the image width "
        f"to the calibrated width, about {{}}, {_TOML}",
        _another_size,
        is_far=False,
    ),
    Reading(
        "cut_images",
        "the calibration seems to be for images before they were cut: the returns fit them better "
        "{}. Subtract the columns and rows that were cut at the left and above from cx and cy, "
        + _TOML,
        _cut_images,
        is_far=False,
    ),
    Reading("exchanged_centre", "cx and cy seem to be exchanged", _exchanged, is_far=False),
    Reading(
        "stereo_pair",
        "each image seems to hold both images of a stereo pair, side by side: cut them in half",
        partial(_changed_image, LEFT_HALF),
        changes_image=True,
    ),
    Reading(
        "mirrored",
        "the returns fit the mirrored image: the image or the depth is flipped left to right",
        partial(_flipped, np.s_[:, ::-1]),
        is_far=False,
    ),
    Reading(
        "depth_upside_down",
        "the returns fit the image with its rows in reverse: turn over the rows of the depth maps",
        partial(_flipped, np.s_[::-1, :]),
        is_far=False,
    ),
    Reading(
        "image_upside_down",
        "the images seem to be upside down: turn them by 180 degrees, and the calibration with "
        "them",
        partial(_changed_image, UPSIDE_DOWN),
        changes_image=True,
    ),
    Reading("unit", "the returns are {}", _scaled, figures=_ratio, is_far=False),
    Reading(
        "inverse_depth",
        "the returns are far where the depth predicted from the image is near: they may be inverse "
        "depth or disparity",
        _inverse_depth,
    ),
    Reading(
        "range_instead_of_depth_along_axis",
        "the depth maps seem to hold the range along the ray instead of the depth along the "
        "optical axis: divide it by the length of the ray (x, y, 1)",
        _along_ray,
        **_SMALL | {"floor": 0.15},
    ),
    Reading(
        "other_lens",
        "the lens seems to belong to other images, rectified or raw: they fit better with {}",
        _other_lens,
        **_SMALL,
    ),
    Reading(
        "focal_length",
        "the focal length seems to belong to other images: the returns fit better with {} times it",
        partial(_other_focal, of_map=False),
        **_SMALL,
    ),
    Reading(
        "depth_camera",
        "the depth maps seem to be those of another camera, of {} times the focal length: "
        "register them to the image",
        partial(_other_focal, of_map=True),
        **_SMALL,
    ),
    Reading(
        "other_camera",
        "the images seem to be those of another camera, such as the other one of a stereo pair: "
        "the returns fit better {}",
        partial(_moved, axis=0, distances_m=_BASELINES_M, words=("to the left", "to the right")),
        **_SMALL,
    ),
    Reading(
        "delay_or_ahead",
        _BETTER
        + "{}: scans or images are delayed, or the position of the LiDAR is wrong along the "
        "view; at a constant speed both look the same",
        partial(_moved, axis=2, distances_m=_AHEAD_M, words=("farther", "nearer")),
        **_SMALL,
    ),
)
