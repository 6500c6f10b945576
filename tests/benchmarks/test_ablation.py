"""The table of an ablation: in mm, read back as it was written, and outliers at the edge."""

import pytest

import ablation


def test_a_table_is_read_back_as_it_was_written():
    runs = [{"miou": 0.5, "mae_m": 1.5, "rmse_m": 4.0}, {"miou": 0.52, "mae_m": 1.7, "rmse_m": 4.2}]
    results = {"one": runs, "two": [{"boundary_f": 0.7}]}
    table = ablation.markdown(results)
    assert "| one | 2 | 51.00 ± 1.41 |  | 1600 ± 141 | 4100 ± 141 |" in table
    read = ablation.read_table(f"# Title\n\n{table}\nend | of it")
    assert read["one"]["mae_m"] == (1600, 141)
    assert read["two"].keys() == {"boundary_f"}


@pytest.mark.parametrize(("values", "outside"), [
    ([1605, 1602, 1489, 1446, 4194, 1502], 4194), ([49.3, 49.7, 50.0, 42.1], None),
    ([77.6, 77.7, 77.6, 76.4, 67.1, 82.4, 81.2], 67.1), ([5.0], None),
])  # fmt: skip
def test_an_outlier_does_not_stretch_the_axis(values, outside):
    low, high = ablation._limits(values)
    assert [value for value in values if not low <= value <= high] == [outside] * bool(outside)


def test_rows_are_drawn_without_training(tmp_path):
    table = tmp_path / "table.md"
    table.write_text(ablation.markdown({"one": [{"miou": 0.5, "mae_m": 1.5}], "two": [{}]}))
    ablation.main(["--table", str(table), "--plot", str(tmp_path / "plot.png")])
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
