"""Rows of scores as a table."""

from dataclasses import replace

from training.evaluation.score_report import Row, format_table

ROW = Row("a", "torch on cpu", "x", "64", "none", 3, {"miou": 0.5, "mae_m": 1.25})


def cells(line):
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_the_table_has_the_figures_that_some_row_has():
    other = replace(ROW, figures={"mae_m": 2.0, "rmse_m": 3.0})
    header, line, *rows = format_table([ROW, other], all_columns=True).splitlines()
    assert cells(header)[:6] == ["model", "data", "frames", "LiDAR", "engine", "fault"]
    assert cells(header)[6:] == ["mIoU %", "MAE [m]", "RMSE [m]"]
    assert set(line) == {"|", "-"}
    assert [cells(row) for row in rows] == [
        ["a", "x", "3", "64", "torch on cpu", "none", "50.000", "1.250", ""],
        ["a", "x", "3", "64", "torch on cpu", "none", "", "2.000", "3.000"],
    ]


def test_other_figures_are_shown_when_all_are_asked_for():
    names = ("miou", "accuracy", "mae_m", "rmse_m", "boundary_f", "fwiou", "imae_per_km", "mae_px")
    row = replace(ROW, figures=dict.fromkeys(names, 0.5))
    header, *_, note = format_table([row]).splitlines()
    assert {"mIoU %", "boundary F %", "MAE [m]", "disparity MAE [px]"} <= set(cells(header))
    assert not {"fwIoU %", "iMAE [1/km]", "engine", "fault"} & set(cells(header))
    assert note.startswith("2 more metrics")
    header, *_ = format_table([row], all_columns=True).splitlines()
    assert len(set(cells(header))) == 6 + len(names)
    assert "fault" in format_table([row, replace(row, fault="nan")])


def test_what_a_set_lacks_is_named_once_below_the_table():
    heads = ("semantic", "depth")
    depth, labels = replace(ROW, figures={"mae_m": 1.25}), replace(ROW, figures={"miou": 0.5})
    rows = [replace(depth, heads=heads)] * 2 + [replace(labels, data="y", heads=heads)]
    rows += [replace(depth, heads=("depth",)), replace(ROW, data="z", heads=heads)]
    notes = [line for line in format_table(rows).splitlines() if not line.startswith("|")]
    assert [note.partition(";")[0] for note in notes] == [
        "x: none of the 3 frames has labels as ground truth",
        "y: none of the 3 frames has depth as ground truth",
    ]
    assert format_table([replace(ROW, figures={})]) == "a on x, LiDAR 64: nothing to score"
