"""Rows of scores as a table."""

from dataclasses import replace

from training.evaluation.score_report import Row, format_table


def test_table_leaves_out_what_no_row_has():
    rows = [Row("a", "torch on cpu", "x", "64", "none", 3, {"miou": 0.5, "mae_m": 1.25})]
    header, line, row = format_table(rows, all_columns=True).splitlines()
    assert "mIoU %" in header
    assert "boundary" not in header
    assert set(line) == {"|", "-"}
    assert [cell.strip() for cell in row.split("|")[1:-1]] == [
        *("a", "x", "3", "64", "torch on cpu", "none", "50.000", "1.250")
    ]


def test_about_ten_columns_are_printed_unless_all_are_asked_for():
    names = ("miou", "accuracy", "mae_m", "rmse_m", "boundary_f", "fwiou", "imae_per_km", "mae_px")
    figures = dict.fromkeys(names, 0.5)
    row = Row("a", "torch on cpu", "x", "64", "none", 3, figures)
    header, _, cells, note = format_table([row]).splitlines()
    titles = [title.strip() for title in header.split("|")[1:-1]]
    assert titles[:6] == ["model", "data", "frames", "LiDAR", "mIoU %", "Acc %"]
    assert {"boundary F %", "MAE [m]", "RMSE [m]"} <= set(titles)
    assert cells.count("|") == header.count("|")
    assert note == f"{len(figures) - len(titles) + 4} more metrics with --all or --json"
    header, *_ = format_table([row], all_columns=True).splitlines()
    every = [title.strip() for title in header.split("|")[1:-1]]
    assert len(every) == len(set(every)) == 6 + len(figures)
    assert set(titles) < set(every)
    assert "fault" in format_table([row, replace(row, fault="nan")])


def test_rows_without_figures_are_lines_below_the_table():
    scored = Row("a", "torch on cpu", "x", "64", "none", 3, {"mae_m": 1.25})
    empty = Row("a", "torch on cpu", "y", "own", "none", 2, {})
    *_, note = format_table([scored, empty]).splitlines()
    text = "a on y, LiDAR own: nothing to score"
    assert note == text
    assert format_table([empty]) == text


def test_truth_that_a_set_lacks_is_named_once():
    def row(data, figures, *heads):
        return Row("a", "torch on cpu", data, "64", "none", 3, figures, heads=heads)

    depth, labels, heads = {"mae_m": 1.25}, {"miou": 0.5}, ("semantic", "depth")
    rows = [row("x", depth, *heads), row("x", depth, *heads), row("y", labels, *heads)]
    rows += [row("x", depth, "depth"), row("z", depth | labels, *heads)]
    notes = [line for line in format_table(rows).splitlines() if not line.startswith("|")]
    example = "; use a set with it, for example folders:DIR,"
    assert notes == [
        f"x: none of the 3 frames has labels as ground truth{example}labels=FOLDER",
        f"y: none of the 3 frames has depth as ground truth{example}depth=FOLDER",
    ]
