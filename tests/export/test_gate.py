"""How much accuracy a quantised file may lose."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from export.accuracy import Accuracy, accuracy_of
from export.gate import find_missed, require_truth
from export.options import ExportOptions
from runtime import InputError
from training.scores.score_set import Row
from training.scores.scoring import Scores

ROW = Accuracy("street", "own", 120, 0.7, 0.5, 0.6, 0.63, {"tree": 0.9})

OPTIONS = ExportOptions(checkpoint_path=Path("m.pt"), onnx_path=Path("m.onnx"))


@pytest.mark.parametrize(
    ("kept", "missed", "words"),
    [
        ({"miou": 0.696}, {"miou": 0.694}, "semantic loses 0.60 points of mIoU on street"),
        ({"mae_m": 0.509}, {"mae_m": 0.511}, "depth's MAE rises by 2.20 % on street, LiDAR own"),
        ({"boundary_f": 0.591}, {"boundary_f": 0.589}, "boundary loses 0.0110 of F on street"),
        ({"coverage_1": 0.601}, {"coverage_1": 0.599}, "depth_uncertainty changes by 3.10 points"),
        ({"coverage_1": 0.659}, {"coverage_1": 0.661}, "depth_uncertainty changes by 3.10 points"),
        ({"class_iou": {"tree": 0.871}}, {"class_iou": {"tree": 0.869}}, "3.10 points of the IoU"),
    ],
)
def test_the_gate_holds_what_each_head_loses(kept, missed, words):
    assert not find_missed([ROW], [replace(ROW, **kept)], OPTIONS)
    (text,) = find_missed([ROW], [replace(ROW, **missed)], OPTIONS).values()
    assert words in text


def test_few_frames_widen_the_limits_by_the_interval_of_the_difference():
    after = replace(ROW, miou=0.694, mae_m=0.511)
    widths = {("street", "own"): {"miou": 0.002, "mae_m": 0.002}}
    assert not find_missed([ROW], [after], OPTIONS, widths)
    assert len(find_missed([ROW], [replace(after, miou=0.692)], OPTIONS, widths)) == 1


def test_the_head_that_misses_most_comes_first():
    after = replace(ROW, miou=0.68, boundary_f=0.58, mae_m=0.6)
    assert list(find_missed([ROW], [after], OPTIONS)) == ["depth", "semantic", "boundary"]


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        ({"miou": None}, "no set has labels of the model's classes, so the loss of the semantic"),
        ({"mae_m": None}, "no set has depth, so the loss of the depth"),
    ],
)
def test_each_head_needs_truth(unknown, message):
    heads = ("semantic", "depth", "boundary")
    require_truth(heads, [ROW, replace(ROW, **unknown)])
    require_truth(("boundary",), [replace(ROW, **unknown)])
    with pytest.raises(InputError, match=message):
        require_truth(heads, [replace(ROW, **unknown)])


@pytest.mark.parametrize(
    ("frames", "pixels", "compared"), [(10, 2000, True), (9, 3000, False), (10, 1999, False)]
)
def test_a_class_is_compared_from_so_many_pixels_and_frames(frames, pixels, compared):
    scores = Scores(3)
    for _ in range(frames):
        labels = np.full((1, 3000), 255, np.uint8)
        labels[:, :pixels] = 1
        scores.semantic.update(np.where(labels == 255, 0, labels), labels)
    names = ["road", "tree", "sky"]
    figures, labelled = scores.figures(names), scores.labelled(names)
    assert labelled == {"tree": (frames * pixels, frames)}
    row = Row("m", "e", "d", "own", "none", frames, figures, labelled=labelled)
    assert accuracy_of(row).class_iou == ({"tree": 1.0} if compared else {})
