"""Usual mistakes in extrinsics, and scans of other frames, are named."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from painted_street import EXTRINSICS, paint, scan_of, street
from runtime.alignment import pairing
from runtime.alignment.calibrate import Verdict, judge
from runtime.alignment.fit_scores import rotation
from runtime.alignment.mistakes import find_mistake
from runtime.alignment.search import find_coarse

# The LiDAR is tilted, so that no two mistakes have the same result.
RIGHT = EXTRINSICS.copy()
RIGHT[:3, :3] = rotation((12, -8, 5)) @ EXTRINSICS[:3, :3]
AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
QUARTER = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
SWAPPED = "the axes of camera (z ahead) and LiDAR (x ahead, z up) seem to be swapped"


def transposed():
    mixed = RIGHT.copy()
    mixed[:3, :3] = RIGHT[:3, :3].T
    return mixed


def shifted(factor):
    far = RIGHT.copy()
    far[:3, 3] *= factor
    return far


@pytest.mark.parametrize(("wrong", "text"), [
    (np.linalg.inv(RIGHT), "the matrix seems to be camera to LiDAR: take its inverse"),
    (transposed(), "its rotation seems to be camera to LiDAR: transpose it"),
    (AXES.T @ RIGHT, f"{SWAPPED}: turn the result of the matrix"),
    (AXES @ RIGHT, f"{SWAPPED}: turn the result of the matrix"),
    (RIGHT @ AXES.T, f"{SWAPPED}: turn the points first"),
    (RIGHT @ AXES, f"{SWAPPED}: turn the points first"),
    (np.linalg.inv(AXES.T @ RIGHT), f"{SWAPPED}, and the matrix to be camera to LiDAR"),
    (RIGHT @ np.diag([-1, -1, 1, 1.0]), "turned by 180 degrees about its z axis"),
    (RIGHT @ np.diag([1, -1, -1, 1.0]), "turned by 180 degrees about its x axis"),
    (RIGHT @ QUARTER, "turned by 270 degrees about its z axis"),
    (RIGHT @ QUARTER.T, "turned by 90 degrees about its z axis"),
    (shifted(100), "its position seems to be in centimetres: divide it by 100"),
    (shifted(1000), "its position seems to be in millimetres: divide it by 1000"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore:assumed the LiDAR is")
def test_a_usual_mistake_is_named_and_undone(wrong, text):
    views = [street(seed, wrong, right=RIGHT) for seed in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is said of the extrinsics that are tried
        mistake = find_mistake(views)
    assert mistake is not None
    assert text in mistake.text
    assert np.allclose(mistake.undo(wrong), RIGHT)


def test_the_right_extrinsics_and_scans_that_fit_nowhere_are_no_mistake():
    assert find_mistake([street(seed) for seed in range(2)]) is None
    blind = []
    for seed in range(2):
        view = street(seed, np.linalg.inv(RIGHT), right=RIGHT)
        noise = np.random.default_rng(seed).normal(0, 2.5, view.log_depth.shape)
        blind.append(replace(view, log_depth=(view.log_depth + noise).astype(np.float32)))
    assert find_mistake(blind) is None, "the depth must clearly correlate"
    random, views = np.random.default_rng(0), []
    for seed in range(4):
        points = scan_of(np.float32([[10]]) * np.ones((120, 360), np.float32))
        points *= random.uniform(0.5, 4, (len(points), 1)).astype(np.float32)
        views.append(street(seed, points=points))
    assert find_mistake(views) is None
    result = judge(views, views[0].calibration, None)
    assert result.verdict is Verdict.NOT_VISIBLE, result.reason
    assert "the returns fit the images nowhere near" in result.reason
    assert result.refined is None
    assert result.off_degrees is None


@pytest.mark.parametrize("beside", ["before", "after"])
def test_scans_of_other_frames_are_no_rotation(beside):
    views = []
    for seed in range(4):
        own = scan_of(paint(seed))
        neighbours = (own, None) if beside == "before" else (None, own)
        views.append(street(seed, points=scan_of(paint(seed + 4)), neighbours=neighbours))
    result = judge(views, views[0].calibration, None)
    assert result.verdict is Verdict.OTHER_SCANS, result.reason
    assert f"the frames {beside} fit" in result.reason
    assert result.refined is None


def test_the_same_scans_beside_a_wrong_calibration_are_no_fault_of_the_pairing():
    extrinsics = EXTRINSICS.copy()
    extrinsics[:3, :3] = rotation((2, 0, 0)) @ EXTRINSICS[:3, :3]
    beside = [scan_of(paint(seed)) for seed in range(3)]
    views = [street(seed, extrinsics, neighbours=(beside[seed], None)) for seed in range(3)]
    assert pairing.find_pairing_fault(views, find_coarse(views)) is None


@pytest.mark.parametrize(("of_neighbours", "is_fault"), [
    ((1.1, 1.1, 1.1), True), ((1.01, 1.01, 1.01), False), ((1.4, 0.9, 1.0), False),
], ids=["clear", "too little", "by chance"])  # fmt: skip
def test_a_neighbouring_scan_must_fit_clearly_better(monkeypatch, of_neighbours, is_fault):
    figures = iter([np.ones(3), np.array(of_neighbours)])
    monkeypatch.setattr(pairing, "total_scores", lambda views, angles: next(figures))
    monkeypatch.setattr(pairing, "find_coarse", lambda views: np.zeros(3))
    views = [street(seed, neighbours=(street(seed).points, None)) for seed in range(3)]
    assert (pairing.find_pairing_fault(views, np.zeros(3)) is not None) is is_fault
