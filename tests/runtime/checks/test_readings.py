"""Each row of the table is named where a recording was made wrong in its way, and nowhere else."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from painted_street import (
    EXTRINSICS,
    FOCAL,
    SIZE,
    judged,
    paint,
    scan_of,
    street,
    street_map,
    turned_extrinsics,
)
from runtime.checks.catalog import FINDINGS
from runtime.checks.finding import Severity
from runtime.checks.judge import NO_EVIDENCE, NO_RETURNS, NOWHERE
from runtime.checks.poses import OTHER_POSES, POSES
from runtime.checks.readings import READINGS
from runtime.checks.view import LEFT_HALF, UPSIDE_DOWN, Answer
from runtime.geometry.lens import Lens

# The LiDAR is tilted, so that no two readings have the same effect.
RIGHT = turned_extrinsics((12, -8, 5))
AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
QUARTER = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
HEIGHT, WIDTH = SIZE


def found(make):
    """The name and text of what is found of five streets, and how severe it is."""
    views = [make(seed) for seed in range(5)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is said of the extrinsics that are tried
        findings = judged(views).findings
    return findings[0] if findings else None


def with_matrix(wrong, right=RIGHT):
    return lambda seed: street(seed, wrong, right=right)


def transposed():
    mixed = RIGHT.copy()
    mixed[:3, :3] = RIGHT[:3, :3].T
    return mixed


def shifted(factor):
    far = RIGHT.copy()
    far[:3, 3] *= factor
    return far


def in_camera(seed):
    return street(seed, RIGHT, points=scan_of(paint(seed), np.eye(4)))


def with_camera(*, focal=1.0, centre=None, **changes):
    """Streets whose calibration has another camera."""

    def make(seed):
        matrix = np.array(
            [[FOCAL * focal, 0, WIDTH / 2], [0, FOCAL * focal, HEIGHT / 2], [0, 0, 1]]
        )
        matrix[:2, 2] = matrix[:2, 2] if centre is None else centre
        return replace(street(seed), intrinsics=matrix, **changes)

    return make


def with_answer(way):
    def make(seed):
        view, answer = street(seed), street(seed).answer
        answer = Answer(answer.boundary[way], answer.log_depth[way])
        return replace(view, answer=answer)

    return make


def upside_down(seed):
    """The model sees noise, and the street where the image is turned."""
    view = street(seed)
    random = np.random.default_rng(seed)
    noise = random.normal(2, 1, (2, *SIZE)).astype(np.float32)
    answers = {UPSIDE_DOWN: view.answer}
    return replace(view, answer=Answer(*noise), others=answers.get)


def stereo_pair(seed):
    """The calibration of the left half, which the model sees well if it is alone."""
    view = street(seed)
    random = np.random.default_rng(seed)
    pair = random.normal(2, 1, (2, HEIGHT, 2 * WIDTH)).astype(np.float32)
    answers = {LEFT_HALF: view.answer}
    return replace(view, answer=Answer(*pair), size=(HEIGHT, 2 * WIDTH), others=answers.get)


def moved(metres, axis):
    given = EXTRINSICS.copy()
    given[axis, 3] += metres
    return with_matrix(given, EXTRINSICS)


def turned(angles):
    return with_matrix(turned_extrinsics(angles), EXTRINSICS)


def of_other_camera(scale):
    """A depth map of a camera with another focal length."""
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    change = np.column_stack([np.eye(2) * scale, middle * (1 - scale)])
    return lambda seed: street_map(
        seed, lambda depth: cv2.warpAffine(depth, change, SIZE[::-1], flags=cv2.INTER_NEAREST)
    )


def late(seed):
    return street(
        seed, points=scan_of(paint(seed + 9)), beside={"0.3 s after": scan_of(paint(seed))}
    )


@pytest.mark.filterwarnings("ignore:assumed the LiDAR is")
@pytest.mark.parametrize(("name", "make", "text"), [
    ("other_time", late, "scans of 0.3 s after fit"),
    ("turned", turned((1.5, 0, 0)), "better turned by -"),
    ("turned", turned((0, -1.5, 0)), "of pitch: run ssdnet-calibrate"),
    # The axes seem to be swapped in an inverse that looks alike.
    ("turned", turned((2.5, -1.5, 0)), "better turned by -"),
    ("inverse_extrinsics", with_matrix(np.linalg.inv(RIGHT)), "take its inverse"),
    ("transposed_rotation", with_matrix(transposed()), "transpose it"),
    ("points_in_camera", in_camera, 'points_in = "camera"'),
    ("swapped_axes", with_matrix(AXES.T @ RIGHT), "turn the result of the matrix"),
    ("swapped_axes", with_matrix(AXES @ RIGHT), "turn the result of the matrix"),
    ("swapped_axes", with_matrix(RIGHT @ AXES.T), "turn the points first"),
    ("swapped_axes", with_matrix(np.linalg.inv(AXES.T @ RIGHT)), "to be camera to LiDAR"),
    ("turned_lidar", with_matrix(RIGHT @ np.diag([-1, -1, 1, 1])), "180 degrees about its z"),
    ("turned_lidar", with_matrix(RIGHT @ np.diag([1, -1, -1, 1])), "180 degrees about its x"),
    ("turned_lidar", with_matrix(RIGHT @ QUARTER), "270 degrees about its z axis"),
    ("turned_lidar", with_matrix(RIGHT @ QUARTER.T), "90 degrees about its z axis"),
    ("position_units", with_matrix(shifted(100)), "in centimetres: divide it by 100"),
    ("position_units", with_matrix(shifted(1000)), "in millimetres: divide it by 1000"),
    ("image_size", with_camera(focal=2, centre=(WIDTH, HEIGHT)), "intrinsics by the ratio"),
    ("cut_images", with_camera(centre=(WIDTH / 2, HEIGHT / 2 + 20)), "0 px farther left and 20 px"),
    ("exchanged_centre", with_camera(centre=(HEIGHT / 2, WIDTH / 2)), "cx and cy"),
    ("stereo_pair", stereo_pair, "cut them in half"),
    ("mirrored", with_answer(np.s_[:, ::-1]), "flipped left to right"),
    ("mirrored", lambda seed: street_map(seed, lambda depth: depth[:, ::-1]), "flipped"),
    ("depth_upside_down", lambda seed: street_map(seed, lambda depth: depth[::-1]), "rows"),
    ("image_upside_down", upside_down, "turn them by 180 degrees"),
    ("unit", lambda seed: street_map(seed, lambda depth: depth * np.float32(3.9)),
     "3.9 times as far as the depth predicted from the image: try `depth_scale=1000`"),
    ("unit", lambda seed: street(seed, points=scan_of(paint(seed)) * 10), "check their unit"),
    ("inverse_depth", lambda seed: street_map(seed, lambda depth: 1 / depth), "disparity"),
    ("other_lens", with_camera(lens=Lens.of("plumb_bob", (-0.3, 0, 0, 0))), "0 times the coeff"),
    ("focal_length", with_camera(focal=1.25), "0.8 times it"),
    ("depth_camera", of_other_camera(0.8), "0.8 times"),
    ("other_camera", moved(0.54, 0), "0.54 m to the right"),
    ("delay_or_ahead", moved(2.0, 2), "2 m nearer"),
])  # fmt: skip
def test_a_row_is_named_where_it_is_so(name, make, text):
    finding = found(make)
    assert finding is not None
    assert finding.name == name, finding.text
    assert text in finding.text


def test_every_row_is_tried_and_is_listed():
    tried = {"range_instead_of_depth_along_axis"}  # no frame here tells it apart
    marks = test_a_row_is_named_where_it_is_so.pytestmark
    tried |= {case[0] for mark in marks if mark.name == "parametrize" for case in mark.args[1]}
    assert tried == {each.name for each in READINGS}
    others = {OTHER_POSES, NOWHERE, NO_RETURNS, NO_EVIDENCE, "no_match", "lens_ends"}
    assert FINDINGS.keys() == {each.name for each in READINGS} | POSES.keys() | others


@pytest.mark.parametrize("make", [street, street_map])
def test_what_is_right_is_no_other_reading(make):
    judgement = judged([make(seed) for seed in range(5)])
    assert judgement.findings == ()
    assert {"turned", "focal_length" if make is street else "depth_camera"} <= {*judgement.tested}


def test_a_calibration_of_the_whole_image_is_of_no_stereo_pair():
    def blind(seed):
        """The model sees noise in the whole image, and the street in its left half."""
        view, pair = street(seed), stereo_pair(seed)
        matrix = view.intrinsics.copy()
        matrix[0, 2] = WIDTH
        return replace(pair, intrinsics=matrix)

    finding = found(blind)
    assert finding is None or finding.name != "stereo_pair"


def test_small_readings_are_warnings_and_others_faults():
    severities = {each.name: each.severity for each in READINGS}
    assert found(turned((1.5, 0, 0))).severity is Severity.WARNING
    assert found(with_matrix(np.linalg.inv(RIGHT))).reason == "implausible_depth"
    assert severities["focal_length"] is Severity.WARNING
