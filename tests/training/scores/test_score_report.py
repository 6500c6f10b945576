"""Rows of scores as a table."""

from dataclasses import replace

import pytest

from training.scores.score_report import format_table
from training.scores.score_set import Row

ROW = Row("a", "torch on cpu", "x", "64", "none", 3, {"miou": 0.5, "mae_m": 1.25})


def cells(line):
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_all_figures_are_a_line_each_and_a_column_a_model():
    other = replace(ROW, model="b", figures={"mae_m": 2.0, "rmse_m": 3.0, "mae_m_return_0_px": 0.5})
    title, _, header, line, *rows = format_table([ROW, other], all_columns=True).splitlines()
    assert title == "**x, LiDAR 64**"
    assert cells(header) == ["figure", "a", "b"]
    assert set(line) == {"|", "-"}
    assert [cells(row) for row in rows] == [
        ["frames", "3", "3"],
        ["runs in", "torch on cpu", "torch on cpu"],
        ["mIoU %", "50.00", ""],
        ["MAE mm", "1250.0", "2000.0"],
        ["MAE at a return, mm", "", "500.0"],
        ["RMSE mm", "", "3000.0"],
    ]


def test_main_figures_are_a_line_a_row_and_the_others_are_counted():
    names = ("miou", "accuracy", "mae_m", "rmse_m", "boundary_f", "fwiou", "imae_per_km", "mae_px")
    row = replace(ROW, figures=dict.fromkeys(names, 0.5))
    header, *_, note = format_table([row]).splitlines()
    assert {"mIoU %", "boundary F %", "MAE mm", "disparity MAE px"} <= set(cells(header))
    assert not {"fwIoU %", "iMAE 1/km", "fault"} & set(cells(header))
    assert note.startswith("2 more figures")
    assert "fault" in format_table([row, replace(row, fault="nan")])
    assert "2 more" not in format_table([row], all_columns=True)


@pytest.mark.parametrize("all_columns", [False, True])
def test_a_table_that_is_too_wide_is_several(all_columns):
    """Nothing is lost, the first columns are repeated, and every line fits."""
    names = (
        "miou", "accuracy", "mae_m", "rmse_m", "boundary_f", "mae_px", "road_iou", "coverage_1",
    )  # fmt: skip
    rows = [replace(ROW, model=f"model-{n}", figures=dict.fromkeys(names, 0.5)) for n in range(9)]
    wide = format_table(rows, all_columns=all_columns)
    narrow = format_table(rows, all_columns=all_columns, width=64)
    assert max(map(len, wide.splitlines())) > 64 >= max(map(len, narrow.splitlines()))
    assert wide.count("| 50.00 ") == narrow.count("| 50.00 ")
    first = "| figure" if all_columns else "| model "
    assert narrow.count(first) > wide.count(first) == 1


def test_what_a_set_lacks_is_named_once_below_the_table():
    heads = ("semantic", "depth")
    depth, labels = replace(ROW, figures={"mae_m": 1.25}), replace(ROW, figures={"miou": 0.5})
    classes = replace(labels, data="y", heads=heads, without_focal=3)  # nobody asks for depth
    rows = [replace(depth, heads=heads)] * 2 + [classes]
    rows += [replace(depth, heads=("depth",)), replace(ROW, data="z", heads=heads)]
    notes = [line for line in format_table(rows).splitlines() if not line.startswith("|")]
    assert [note.partition(";")[0] for note in notes] == [
        "x: none of the 3 frames has labels as ground truth",
    ]
    assert format_table([replace(ROW, figures={})]) == "a on x, LiDAR 64: nothing to score"
