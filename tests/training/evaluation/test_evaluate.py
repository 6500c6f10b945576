"""Names of models and sets in the rows."""

from pathlib import Path

from training.evaluation.evaluate import short_names


def test_paths_of_equal_names_get_more_of_their_parts():
    assert short_names([Path("a/model.pt"), Path("b/model.pt")]) == ["a/model.pt", "b/model.pt"]
    assert short_names([Path("x/a/1"), Path("x/a/2")]) == ["1", "2"]
    assert short_names([Path()]) == ["."]
