"""`calibrate`: whether the rotation of a calibration is right, and how far it is off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.alignment.fit_scores import AXES, FitScores, fit_scores, rotation
from runtime.alignment.mistakes import find_mistake, without
from runtime.alignment.pairing import find_pairing_fault
from runtime.alignment.search import Optimum, find_coarse, find_rotation
from runtime.alignment.selection import choose_frames
from runtime.alignment.view import View, view_of
from runtime.base.arguments import check_integer
from runtime.base.errors import InputError
from runtime.engine.predictor import Predictor
from runtime.geometry.calibration import Calibration
from runtime.recordings.source import Source
from runtime.streams.answerer import known_focal_length_px
from runtime.streams.frame import Frame

_HEADS = ("boundary", "depth")
_LEAST_FRAMES = 3
_THUMBNAIL = 64, 24  # columns and rows of the boundary by which scenes are told apart
_FAR_M = 3.0  # a position beyond this may have another unit
# What standard errors do not contain, for yaw, pitch and roll [degrees], 95 %. One part is a
# deviation of the network that is the same in all frames. The other is the same in the frames of
# one scene and averages out over several scenes. For a vehicle that was not measured they may be
# too small: docs/results.md has the factors that two vehicles give (benchmarks/calibration.py).
_FLOOR_DEGREES = np.array([0.25, 0.45, 0.9])
_SCENE_DEGREES = np.array([0.5, 1.3, 4.4])
# An axis counts as seen if 95 % of the answers lie within this.
SEEN_DEGREES = np.array([1.0, 1.5, 2.5])
_TAKE_MORE = "not visible in these frames: {}; take more frames, with near objects"

_Floats = NDArray[np.float64]


class Verdict(StrEnum):
    """What the frames of a recording show about its calibration."""

    RIGHT = "right"
    OFF = "off"
    OTHER_SCANS = "other_scans"  # the images are paired with scans of another time
    NOT_VISIBLE = "not_visible"


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What `calibrate` found, given the position and the intrinsics of the calibration.

    Attributes:
        verdict: the result in one word.
        reason: the result in a sentence.
        given: the calibration of the recording.
        refined: the calibration to use: `given` if it is right, a corrected one if it is off, None
            if the frames do not show it.
        off_degrees: float64 (3,), yaw, pitch and roll by which the returns lie too far to the
            right, too high, and too far clockwise in the image; None without evidence. If a usual
            mistake was found, these are the angles that remain without it.
        within_degrees: float64 (3,), uncertainty of each angle, 95 %; infinite for an axis that
            these frames do not show.
        mistake: a usual mistake, in words, that seems to have been made; None if there is none.
        before: edge and depth figure with the given calibration, medians over the frames.
        after: edge and depth figure with the refined calibration.
        range_m: distance at which an error of position looks like one of rotation, see
            `alternatives`.
        frames: names of the frames that were compared.
        scenes: effective number of scenes among them, see `count_scenes`.
        example: one of the frames, to be drawn.
    """

    verdict: Verdict
    reason: str
    given: Calibration
    refined: Calibration | None
    off_degrees: _Floats | None
    within_degrees: _Floats | None
    mistake: str | None
    before: FitScores
    after: FitScores
    range_m: float
    frames: tuple[str, ...]
    scenes: float
    example: Frame

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Errors of position or intrinsics that would look the same, with their size."""
        if self.off_degrees is None or self.within_degrees is None:
            return ()
        matrix, width = self.given.intrinsics, self.example.size[1]
        lines = []
        for axis, way, centre in ((0, "sideways", "cx"), (1, "in height", "cy")):
            angle = np.radians(abs(self.off_degrees[axis]))
            shift_m, shift_px = np.tan(angle) * self.range_m, np.tan(angle) * matrix[axis, axis]
            a_tenth = np.degrees(np.arctan(0.1 / self.range_m))
            lines.append(
                f"{AXES[axis]} looks the same as a position {shift_m:.2f} m off {way} (0.1 m as "
                f"{a_tenth:.2f} degrees), or as {centre} {shift_px:.0f} px off "
                f"({shift_px / width:.1%} of the width)"
            )
        return tuple(lines)


def calibrate(
    source: Source,
    predictor: Predictor,
    *,
    frames: int = 20,
    on_frame: Callable[[], None] = lambda: None,
) -> CalibrationResult:
    """Check and refine the rotation between the LiDAR and the camera of a recording.

    The model predicts from each image alone. Returns where the scan jumps to something farther must
    lie on boundaries that the model sees, and the predicted depth must correlate with that of the
    returns. First, the images must be paired with their own scans. Position and intrinsics are
    assumed to be right.

    Args:
        source: a recording with scans and a calibration.
        predictor: predictor of a model with boundary and depth, which was not adapted with this
            calibration.
        frames: number of frames to compare, 3 to 1000; more frames give a smaller uncertainty.
        on_frame: called after each frame.

    Raises:
        InputError: if the model lacks one of these heads, or the recording lacks scans or a
            calibration.
    """
    check_integer("frames", frames, _LEAST_FRAMES, 1000, error=InputError)
    if missing := [head for head in _HEADS if head not in predictor.heads]:
        raise InputError(
            f"the model {predictor.contract.model_name} answers no {' and no '.join(missing)}: a "
            "calibration is checked with a bundled model"
        )
    views: list[View] = []
    example: Frame | None = None
    for frame, neighbours in choose_frames(source, frames):
        focal_px = known_focal_length_px(predictor, frame.calibration)
        answer = predictor.predict(frame.rgb, None, focal_length_px=focal_px)
        if (view := view_of(frame, answer, neighbours)) is not None:
            if all(len(view.jumps) > len(each.jumps) for each in views):
                example = frame
            views.append(view)
        on_frame()
    if example is None or example.calibration is None:
        raise InputError("no frame of the recording can be judged: are all images black?")
    return judge(views, source.calibration or example.calibration, example)


def judge(views: list[View], given: Calibration, example: Frame) -> CalibrationResult:
    """Return the verdict: the pairing is judged first, then usual mistakes, then the rotation.

    Args:
        views: views of the frames, in order.
        given: calibration of the recording.
        example: one of the frames.
    """
    seen, fault, mistake, best = [each for each in views if each.has_structure], None, None, None
    if len(seen) >= _LEAST_FRAMES:
        start = find_coarse(seen)
        fault = find_pairing_fault(seen, start)
        best = find_rotation(seen, start)
    before, after = _median(seen), _median(seen, best)
    is_far = np.abs(given.extrinsics[:3, 3]).max() > _FAR_M
    if fault is None and (is_far or not after.fit):
        mistake = find_mistake(views)
    if mistake is not None:
        seen = [each for each in without(views, mistake) if each.has_structure]
        best = find_rotation(seen) if len(seen) >= _LEAST_FRAMES else None
        after = _median(seen, best)
    result = CalibrationResult(
        Verdict.NOT_VISIBLE,
        fault or "",
        given,
        refined=None,
        off_degrees=None,
        within_degrees=None,
        mistake=mistake and mistake.text,
        before=before,
        after=after,
        range_m=_shift_range(seen),
        frames=tuple(view.name for view in seen),
        scenes=count_scenes(seen),
        example=example,
    )
    if fault is not None:
        return replace(result, verdict=Verdict.OTHER_SCANS)
    extrinsics = given.extrinsics if mistake is None else mistake.undo(given.extrinsics)
    return _with_rotation(result, best, extrinsics)


def _with_rotation(
    result: CalibrationResult, best: Optimum | None, extrinsics: _Floats
) -> CalibrationResult:
    """Add the verdict on the rotation; `extrinsics` are those that `best` turns."""
    text, off, within = _measured(result, best)
    has_mistake, is_turned = result.mistake is not None, False
    if off is None and not has_mistake:
        return replace(result, reason=text)
    if off is not None and within is not None and (np.abs(off) > within).any():
        is_turned, extrinsics = True, extrinsics.copy()
        extrinsics[:3, :3] = rotation(np.where(np.isinf(within), 0, -off)) @ extrinsics[:3, :3]
    if result.mistake is not None:
        text = result.mistake if off is None else f"{result.mistake}; then {text}"
    is_off = has_mistake or is_turned
    return replace(
        result,
        verdict=Verdict.OFF if is_off else Verdict.RIGHT,
        reason=text,
        off_degrees=off,
        within_degrees=within,
        refined=replace(result.given, extrinsics=extrinsics) if is_off else result.given,
    )


def _measured(
    result: CalibrationResult, best: Optimum | None
) -> tuple[str, _Floats | None, _Floats | None]:
    """Return what the frames show in words, and the angles and their limits; None if not seen."""
    count = len(result.frames)
    if best is None:
        few = f"{count} frames have structure, at least {_LEAST_FRAMES} are needed"
        return f"not visible: {few}", None, None
    if not result.after.fit:
        return _TAKE_MORE.format("the returns fit the images nowhere near"), None, None
    within = np.hypot(*uncertainty_of(best, count, result.scenes))
    is_seen = within <= SEEN_DEGREES
    if not is_seen[:2].all():
        return _TAKE_MORE.format("yaw +- {:.1f}, pitch +- {:.1f}".format(*within)), None, None
    off, within = -best.angles, np.where(is_seen, within, np.inf)
    measured = _listed(off, within, "{value:+.2f} +- {limit:.2f}")
    if (np.abs(off) > within).any():
        return f"off by {measured}", off, within
    limits = _listed(off, np.abs(off) + within, "{limit:.2f}")
    return f"right within {limits} (measured: {measured})", off, within


def _listed(off: _Floats, limits: _Floats, how: str) -> str:
    """The three angles, in words; an infinite limit marks an axis that is not visible."""
    return ", ".join(
        f"{name} {how.format(value=value, limit=limit)} degrees"
        if np.isfinite(limit)
        else f"{name} not visible"
        for name, value, limit in zip(AXES, off, limits, strict=True)
    )


def uncertainty_of(best: Optimum, frames: int, scenes: float) -> tuple[_Floats, _Floats]:
    """Return the two parts of the uncertainty of yaw, pitch and roll, 95 %, degrees.

    The first part follows from how the frames differ. The second is the floor, which covers what
    all frames have in common.
    """
    freedom = frames - 1
    errors = 1.96 + 2.4 / freedom + 4.5 / freedom**2  # Student's t-distribution, 95 %
    return errors * best.error, np.hypot(_FLOOR_DEGREES, _SCENE_DEGREES / np.sqrt(scenes))


def count_scenes(views: Sequence[View]) -> float:
    """Return the effective number of scenes, 1 to the number of views.

    It is n^2 / sum(r), where r are the correlations of the predicted boundaries of all pairs of
    frames. Before that the mean of each row, which is similar on all roads, is subtracted.
    """
    if not views:
        return 1.0
    small = [cv2.resize(view.boundary, _THUMBNAIL, interpolation=cv2.INTER_AREA) for view in views]
    rows = np.array([(each - each.mean(axis=1, keepdims=True)).ravel() for each in small])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True) + 1e-6
    return float(len(views) ** 2 / np.maximum(rows @ rows.T, 0).sum())


def _median(views: list[View], best: Optimum | None = None) -> FitScores:
    """The figures, medians over the views, as given or turned to the best rotation."""
    if not views:
        return FitScores(0.0, 0.0)
    angles = (0, 0, 0) if best is None else best.angles
    edge, correlation = np.median([fit_scores(view, angles) for view in views], axis=0)
    return FitScores(float(edge), float(correlation))


def _shift_range(views: list[View]) -> float:
    """Depth at which a shift moves the jumps like a turn: the harmonic mean of their depths."""
    depths = [view.jumps[:, 2] for view in views if len(view.jumps)]
    return float(1 / np.mean(1 / np.maximum(np.concatenate(depths), 1))) if depths else np.inf
