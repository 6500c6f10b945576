"""A row of the table, of a made-up predictor."""

import numpy as np
import pytest

import stability
from models import CLASS_TABLES
from runtime.errors import InputError
from stability import run_probes
from training.datasets.sample import Sample
from training.evaluation.scored_model import ScoredModel
from training.evaluation.scoring import HeadMaps

HEIGHT, WIDTH = 20, 100


def answer(like, semantic=3, depth=20.0):
    size = like.shape[:2]
    return HeadMaps(np.full(size, semantic, np.uint8), np.full(size, depth, np.float32), None)


def samples():
    depth = np.full((HEIGHT, WIDTH), 20, np.float32)
    unknown = np.full((HEIGHT, WIDTH), 3, np.uint8)
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    return [Sample(rgb, {"depth": depth, "semantic": unknown}, None, "a", sparse_depth=depth)] * 2


@pytest.mark.parametrize(("classes", "missing"), [("camvid", set()), ("cityscapes", {"camvid"})])
def test_a_row_has_every_figure_that_its_model_can_have(classes, missing):
    model = ScoredModel(lambda rgb, *_: answer(rgb), CLASS_TABLES[classes], "by hand", classes)
    figures = run_probes(model, samples(), samples(), samples())
    known = {key for key, _, _ in stability.COLUMNS if key.split("_")[0] not in missing}
    # Every pixel has a return, and none is sky.
    assert figures.keys() == known - {"shift_depth", "seam", "border"}
    model = ScoredModel(
        lambda rgb, *_: answer(rgb)._replace(depth=None), CLASS_TABLES[classes], "by hand"
    )
    with pytest.raises(InputError, match="semantic and depth"):
        run_probes(model, samples(), samples(), samples())
