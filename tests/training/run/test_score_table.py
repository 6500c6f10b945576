"""The table of scores, and which validation was the best."""

import csv

import pytest

from training.run.score_table import ScoreTable


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_row_a_step_and_set_with_every_figure(tmp_path):
    path = tmp_path / "scores.csv"
    table = ScoreTable(path, 0)
    table.add(2, {"camvid": {"miou": 0.25, "iou_car": 0.5}, "a,b/c": {"mae_m": 1 / 3}}, "")
    table.add(4, {"camvid": {"miou": 0.5, "iou_car": float("nan")}, "a,b/c": {"mae_m": 2.0}}, "")
    assert rows(path) == [
        {"step": "2", "set": "camvid", "miou": "0.25", "iou_car": "0.5", "mae_m": ""},
        {"step": "2", "set": "a,b/c", "miou": "", "iou_car": "", "mae_m": repr(1 / 3)},
        {"step": "4", "set": "camvid", "miou": "0.5", "iou_car": "nan", "mae_m": ""},
        {"step": "4", "set": "a,b/c", "miou": "", "iou_car": "", "mae_m": "2.0"},
    ]


def test_a_resumed_run_has_no_step_twice(tmp_path):
    path = tmp_path / "scores.csv"
    table = ScoreTable(path, 0)
    for step, miou in ((2, 0.1), (4, 0.9), (6, 0.2)):
        table.add(step, {"a": {"miou": miou}}, "")
    table = ScoreTable(path, 3)  # the checkpoint of step 3 is what was left
    assert table.add(4, {"a": {"miou": 0.9}}, "")  # the best again: best.pt may be lost
    assert [row["step"] for row in rows(path)] == ["2", "4"]
    assert not ScoreTable(path, 4).add(6, {"a": {"miou": 0.9}}, "")


@pytest.mark.parametrize(("best", "figure", "values", "expected"), [
    ("", "miou", [0.2, 0.1, 0.3, 0.3], [True, False, True, False]),
    ("", "mae_m", [2.0, 3.0, 1.0, 1.0], [True, False, True, False]),
    ("a/b/irmse_per_km", "irmse_per_km", [2.0, 3.0, 1.0], [True, False, True]),
    ("a/b/iou_car", "iou_car", [float("nan"), 0.1, float("nan"), 0.2], [False, True] * 2),
    ("", "boundary_f", [0.1, 0.2], [False, False]),  # nothing to choose by
])  # fmt: skip
def test_the_best_is_the_highest_score_or_the_smallest_error(
    tmp_path, best, figure, values, expected
):
    table = ScoreTable(tmp_path / "scores.csv", 0)
    shown = [
        table.add(step, {"a/b": {"rmse_px": 1.0 - step, figure: value}}, best)
        for step, value in enumerate(values)
    ]
    assert shown == expected


def test_before_and_after_name_what_became_worse(tmp_path):
    table = ScoreTable(tmp_path / "scores.csv", 0)
    figures = {"miou": 0.5, "mae_m": 0.5, "rmse_m": 2.0, "iou_car": 0.5}
    table.add(0, {"a/b": figures, "c": {"mae_m": 1.0}}, "")
    assert not list(table.compare())  # nothing after
    table.add(4, {"a/b": figures | {"mae_m": 9.0}, "c": {"mae_m": 9.0}}, "")
    after = {"miou": 0.47, "mae_m": 2.25, "rmse_m": 2.05, "iou_car": 0.1}
    table.add(8, {"a/b": after, "c": {"mae_m": 0.5}}, "")
    lines = list(ScoreTable(tmp_path / "scores.csv", 8).compare())
    assert [line.split() for line in lines[:5]] == [
        ["before", "after"],
        ["a/b/miou", "0.5000", "0.4700"],
        ["a/b/mae_m", "0.5000", "2.2500"],
        ["a/b/rmse_m", "2.0000", "2.0500"],
        ["c/mae_m", "1.0000", "0.5000"],
    ]
    texts = ["a/b/miou became worse, from 0.5 to 0.47", "a/b/mae_m became worse, from 0.5 to 2.25"]
    assert [line.split(": compare")[0] for line in lines[5:]] == [
        f"warning: {text}" for text in texts
    ]
    random_start = ScoreTable(tmp_path / "other.csv", 0)
    random_start.add(4, {"a": {"miou": 0.5}}, "")
    assert not list(random_start.compare())
