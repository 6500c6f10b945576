"""Names of sets and models that are scored together."""

from pathlib import Path

from training.scores.evaluated_set import short_names


def test_paths_of_equal_names_get_more_of_their_parts():
    assert short_names([Path("a/model.pt"), Path("b/model.pt")]) == ["a/model.pt", "b/model.pt"]
    assert short_names([Path("x/a/1"), Path("x/a/2")]) == ["1", "2"]
    assert short_names([Path()]) == ["."]
