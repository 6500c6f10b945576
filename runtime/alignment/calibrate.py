"""`calibrate`: whether the rotation of a calibration is right, and how far it is off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np

from runtime.alignment.selection import choose_frames
from runtime.base.arguments import check_integer
from runtime.base.arrays import Float32, Float64
from runtime.base.errors import InputError
from runtime.checks.finding import Finding
from runtime.checks.fit import AXES, FitScores, fit_of, median_fit, rotation, turned
from runtime.checks.judge import NO_EVIDENCE, NOWHERE, Judge, Judgement
from runtime.checks.readings import READINGS, Reading
from runtime.checks.search import Optimum, find_rotation, held_out_gain
from runtime.checks.view import View
from runtime.engine.prediction import Prediction
from runtime.engine.predictor import Predictor
from runtime.geometry.calibration import Calibration
from runtime.recordings.source import Source
from runtime.streams.answerer import known_focal_length_px
from runtime.streams.frame import Frame
from runtime.streams.frame_view import view_of

_HEADS = ("boundary", "depth")
_LEAST_FRAMES = 3
_THUMBNAIL = 64, 24  # columns and rows of the boundary by which scenes are told apart
# What standard errors do not contain, for yaw, pitch and roll [degrees], 95 %. One part is a
# deviation of the network that is the same in all frames. The other is the same in the frames of
# one scene and averages out over several scenes. For a vehicle that was not measured they may be
# too small: docs/results.md has the factors that two vehicles give (benchmarks/calibration.py).
_FLOOR_DEGREES = np.array([0.25, 0.45, 0.9])
_SCENE_DEGREES = np.array([0.5, 1.3, 4.4])
# An axis counts as seen if 95 % of the answers lie within this.
SEEN_DEGREES = np.array([1.0, 1.5, 2.5])
# Least medians of returns that fit. Right calibrations have a depth figure of 0.57 and more and an
# edge figure of 0.06 to 0.18, wrong ones a depth figure of up to 0.07.
_LEAST_CORRELATION, _LEAST_EDGE = 0.5, 0.02
_LEAST_FLOOR = 0.5  # floors of small readings become smaller with more scenes, down to this share
_TAKE_MORE = "not visible in these frames: {}; take more frames, with near objects"
# Readings that are compared before the rotation is searched, and those with the best rotation.
_TURNED, _OTHER_TIME = "turned", "other_time"
_BEFORE = tuple(each for each in READINGS if each.is_far or each.name in (_OTHER_TIME, "unit"))
_AFTER = tuple(each for each in READINGS if each not in _BEFORE and each.name != _TURNED)


class Verdict(StrEnum):
    """What the frames of a recording show about its calibration."""

    RIGHT = "right"
    OFF = "off"
    OTHER_SCANS = "other_scans"  # the images are paired with scans of another time
    OTHER_READING = "other_reading"  # something else than a rotation is wrong
    NOT_VISIBLE = "not_visible"


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationResult:
    """What `calibrate` found, given the position of the calibration.

    Attributes:
        verdict: the result in one word.
        reason: the result in a sentence, with what was tested.
        given: the calibration of the recording.
        refined: the calibration to use: `given` if it is right, one with a corrected rotation if
            frames that were not used for the search fit better with it; else None.
        off_degrees: float64 (3,), yaw, pitch and roll by which the returns lie too far to the
            right, too high, and too far clockwise in the image; None without evidence.
        within_degrees: float64 (3,), uncertainty of each angle, 95 %; infinite for an axis that
            these frames do not show.
        finding: the reading that fits better than the recording as given, or why nothing can be
            judged; None if there is none.
        judgement: which other readings were tested, with the best rotation.
        before: figures with the given calibration, medians over the frames.
        after: figures with the refined calibration.
        range_m: distance at which an error of position looks like one of rotation, see
            `alternatives`.
        frames: names of the frames that were compared.
        scenes: effective number of scenes among them, see `count_scenes`.
        example: one of the frames, to be drawn.
    """

    verdict: Verdict = Verdict.NOT_VISIBLE
    reason: str
    given: Calibration
    refined: Calibration | None = None
    off_degrees: Float64 | None = None
    within_degrees: Float64 | None = None
    finding: Finding | None
    judgement: Judgement
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
    returns. First, other readings of the recording are compared; lens and focal length are compared
    with the best rotation. The position is assumed to be right.

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

    def predict(frame: Frame, _: Float32) -> Prediction:
        focal_px = known_focal_length_px(predictor, frame.calibration)
        return predictor.predict(frame.rgb, None, focal_length_px=focal_px)

    views: list[View] = []
    example: Frame | None = None
    for frame, beside in choose_frames(source, frames):
        answer = predict(frame, frame.sparse_depth)
        if (view := view_of(frame, answer, predict=predict, beside=beside)) is not None:
            if all(len(view.structure[1]) > len(each.structure[1]) for each in views):
                example = frame
            views.append(view)
        on_frame()
    if example is None or example.calibration is None:
        raise InputError("no frame of the recording can be judged: are all images black?")
    return judge(views, source.calibration or example.calibration, example)


def judge(views: list[View], given: Calibration, example: Frame) -> CalibrationResult:
    """Return the verdict: other readings are judged first, then the rotation, then small readings.

    Args:
        views: views of the frames, in order.
        given: calibration of the recording.
        example: one of the frames.
    """
    first, best, second = _judged(views, _BEFORE), None, Judgement()
    seen = [each for each in views if each.has_structure]
    if not first.findings and len(seen) >= _LEAST_FRAMES:
        best = find_rotation(seen)
        second = _judged([turned(each, best.angles) for each in seen], _AFTER)
    finding = next(iter(first.findings or second.findings), None)
    angles = np.zeros(3) if best is None else best.angles
    result = CalibrationResult(
        reason="" if finding is None else finding.text,
        given=given,
        finding=finding,
        judgement=second,
        before=median_fit([fit_of(each) for each in seen]),
        after=median_fit([fit_of(each, angles) for each in seen]),
        range_m=_shift_range(seen),
        frames=tuple(view.name for view in seen),
        scenes=count_scenes(seen),
        example=example,
    )
    if finding is None:
        return _with_rotation(result, seen, best)
    if finding.name in (NO_EVIDENCE, NOWHERE):
        return replace(result, reason=f"not visible: {finding.text}")
    is_time = finding.name == _OTHER_TIME
    return replace(result, verdict=Verdict.OTHER_SCANS if is_time else Verdict.OTHER_READING)


def _judged(views: Sequence[View], readings: Sequence[Reading]) -> Judgement:
    floor = max(_LEAST_FLOOR, 1 / np.sqrt(count_scenes(views)))
    judging = Judge(readings, most=max(len(views), 1), floor=floor)
    for view in views:
        judging.add(view)
    return judging.judgement()


def _with_rotation(
    result: CalibrationResult, views: Sequence[View], best: Optimum | None
) -> CalibrationResult:
    """Add the verdict on the rotation."""
    if best is None:
        few = f"{len(views)} frames have structure, at least {_LEAST_FRAMES} are needed"
        return replace(result, reason=f"not visible: {few}")
    fits = result.after
    if fits.depth_correlation < _LEAST_CORRELATION or fits.edge < _LEAST_EDGE:
        return replace(result, reason=_TAKE_MORE.format("the returns fit the images nowhere near"))
    within = np.hypot(*uncertainty_of(best, len(views), result.scenes))
    is_seen = within <= SEEN_DEGREES
    if not is_seen[:2].all():
        unsure = "yaw +- {:.1f}, pitch +- {:.1f}".format(*within)
        return replace(result, reason=_TAKE_MORE.format(unsure))
    off, within = -best.angles, np.where(is_seen, within, np.inf)
    result = replace(result, off_degrees=off, within_degrees=within)
    measured = _listed(off, within, "{value:+.2f} +- {limit:.2f}")
    words = {"fit worse": result.judgement.tested, "not told apart": result.judgement.not_tested}
    rest = "position as given, not tested"
    rest += "".join(f"; {word}: {', '.join(names)}" for word, names in words.items() if names)
    if (np.abs(off) <= within).all():
        limits = _listed(off, np.abs(off) + within, "{limit:.2f}")
        reason = f"right within {limits} (measured: {measured}); {rest}"
        return replace(result, verdict=Verdict.RIGHT, reason=reason, refined=result.given)
    gain, error = held_out_gain(views)
    by = f"frames that were not used to find it fit by {gain:+.3f} +- {error:.3f} better"
    if gain <= error:
        return replace(result, reason=f"off by {measured}, but {by}: take more frames")
    extrinsics = result.given.extrinsics.copy()
    extrinsics[:3, :3] = rotation(np.where(np.isinf(within), 0, -off)) @ extrinsics[:3, :3]
    refined = replace(result.given, extrinsics=extrinsics)
    reason = f"off by {measured}; {by}; {rest}"
    return replace(result, verdict=Verdict.OFF, reason=reason, refined=refined)


def _listed(off: Float64, limits: Float64, how: str) -> str:
    """The three angles, in words; an infinite limit marks an axis that is not visible."""
    return ", ".join(
        f"{name} {how.format(value=value, limit=limit)} degrees"
        if np.isfinite(limit)
        else f"{name} not visible"
        for name, value, limit in zip(AXES, off, limits, strict=True)
    )


def uncertainty_of(best: Optimum, frames: int, scenes: float) -> tuple[Float64, Float64]:
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
    small = [
        cv2.resize(view.answer.boundary, _THUMBNAIL, interpolation=cv2.INTER_AREA) for view in views
    ]
    rows = np.array([(each - each.mean(axis=1, keepdims=True)).ravel() for each in small])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True) + 1e-6
    return float(len(views) ** 2 / np.maximum(rows @ rows.T, 0).sum())


def _shift_range(views: Sequence[View]) -> float:
    """Depth at which a shift moves the jumps like a turn: the harmonic mean of their depths."""
    depths = [view.structure[1][:, 2] for view in views if len(view.structure[1])]
    return float(1 / np.mean(1 / np.maximum(np.concatenate(depths), 1))) if depths else np.inf
