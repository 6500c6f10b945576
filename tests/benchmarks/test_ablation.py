"""The table of an ablation."""

import ablation


def test_the_table_has_mean_and_deviation_in_the_unit_of_each_column():
    runs = [{"miou": 0.5, "mae_m": 1.5, "rmse_m": 4.0}, {"miou": 0.52, "mae_m": 1.7, "rmse_m": 4.2}]
    table = ablation.markdown({"one": runs, "two": [{"boundary_f": 0.7}]})
    assert "| one | 2 | 51.00 ± 1.41 |  | 1600 ± 141 | 4100 ± 141 |" in table
    assert "| two | 1 |  | 70.00 |  |  |" in table
