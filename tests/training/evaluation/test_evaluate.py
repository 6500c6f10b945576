"""Names of models and sets in the rows."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from models import CLASS_TABLES
from training.datasets.sample import Sample
from training.evaluation.evaluate import ScoredClasses, _score_all, short_names
from training.evaluation.scored_model import ScoredModel
from training.evaluation.scoring import HeadMaps
from training.lidar.split import LidarInput


def test_paths_of_equal_names_get_more_of_their_parts():
    assert short_names([Path("a/model.pt"), Path("b/model.pt")]) == ["a/model.pt", "b/model.pt"]
    assert short_names([Path("x/a/1"), Path("x/a/2")]) == ["1", "2"]
    assert short_names([Path()]) == ["."]


def test_the_boundary_of_all_places_is_scored_at_one_threshold():
    """Two places whose boundaries are found at different thresholds, which no user has."""
    labels = np.zeros((32, 32), np.uint8)
    labels[:, 16:] = 1
    frames = {
        place: Sample(np.full((32, 32, 3), index, np.uint8), {"semantic": labels}, None, place)
        for index, place in enumerate(("north", "south"))
    }
    source = [replace(frame, place=place) for place, frame in frames.items()]

    def predict(rgb, *_):
        weak, strong = ((0.32, 0.42), (0.72, 0.92))[rgb[0, 0, 0]]
        boundary = np.full((32, 32), weak, np.float32)
        boundary[:, 16] = strong
        return HeadMaps(None, None, boundary)

    model = ScoredModel(predict, CLASS_TABLES["camvid"], "none", "camvid")
    classes = ScoredClasses("camvid", tuple(info.name for info in CLASS_TABLES["camvid"]))
    lidars = [LidarInput("none")]
    (row,) = _score_all("m", model, "d", source, classes, lidars, ["none"], None, None)
    thresholds = {figures["boundary_threshold"] for figures in row.places.values()}
    assert thresholds == {row.figures["boundary_threshold"]}
    assert row.figures_over_places["boundary_f"] < 1
