"""ssdnet-lite from PandaSet's street and rendered scenes alone, whose terms permit commercial use.

Three stages of lite, shorter: crops, pairs with a narrower trunk, the depth. The first needs
--init: EfficientNet-Lite0 with a fused start that has learned its features
(benchmarks/fused_start.py). No other weights or data enter, neither as a start, as a teacher, nor
by a choice: what is chosen is chosen on `rendered/open_val` and on the street's camera `right`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from training.datasets.virtual_kitti import RenderedRecipe
from training.recipes import lite, pandaset_street
from training.run.recipe import Recipe, derive
from training.run.stages import Stage
from training.weights.prune import prune_trunk

# Channels of the trunk, with a fused start, before it is pruned and after.
_WIDE = (16, 48, 48, 144, *[240] * 2, *[480] * 3, *[672] * 3, *[1152] * 4)
_PRUNED = (16, 48, 48, 80, *[160] * 2, *[320] * 3, *[480] * 3, *[896] * 3, 640)

_KITTI = RenderedRecipe(path="rendered/kitti", scans=True, weight=0.2)
_VARIED = RenderedRecipe(path="rendered/varied", scans=True, scale=(0.5, 1.5), weight=0.4)
# One pixel of a street's frame in twenty has a class.
_SETS = (*pandaset_street.cameras(0.4, semantic_weight=5.0), _KITTI, _VARIED)
_DEPTH_SETS = (
    *pandaset_street.cameras(0.5),
    replace(_KITTI, weight=0.1),
    replace(_VARIED, weight=0.25),
    # Without the parallax of a LiDAR beside the camera.
    replace(_VARIED, weight=0.15, scans=False, scale=None),
)
_VALIDATION = RenderedRecipe(path="rendered/open_val", scans=True), pandaset_street.camera("right")
# One street in one light: its colours say little about other places.
_COLORS = {
    "brightness": 0.5,
    "contrast": 0.4,
    "saturation": 0.5,
    "hue_deg": 12.0,
    "gray": 0.1,
    "blur": 0.2,
    "noise": 0.15,
    "restyle": 0.5,
    "camera_fault": 0.15,
    "camera_fault_strength": 0.6,
}
_FAULTS = {"restyle": 0.5, "camera_fault": 0.25, "pair_camera_fault": 0.2}


def _open(stage: Recipe, steps: int, widths: Sequence[int] = _PRUNED, **data: Any) -> Recipe:
    """Return a stage of lite with other data."""
    config = {**stage.model.config, "fused_start": True, "encoder_widths": [*widths]}
    return derive(
        stage,
        terms=f"{pandaset_street.TERMS}; rendered scenes: this project's, Apache-2.0",
        own_data_only=True,
        model={"config": config},
        data={"source": _SETS, "augment": _COLORS, **data},
        loss={"weights": {"road": 0.0}},
        schedule={"steps": steps},
        validation={"every": steps, "lidar": "own", "source": _VALIDATION},
    )


CROPS = _open(lite.CROPS, 2000, _WIDE, seed=81)
NARROW = _open(lite.JOINT, 1900, seed=83)
DEPTH = derive(
    _open(lite.DEPTH, 900, seed=84, source=_DEPTH_SETS, augment=_FAULTS),
    optimizer={"fixed_statistics": True},
)

STAGES = (
    Stage("1-crops", CROPS, then=lambda network, pictures: prune_trunk(network, _PRUNED, pictures)),
    Stage("2-narrow", NARROW),
    Stage("3-depth", DEPTH),
)
