"""A task from random weights, alike for every network of the comparison (see docs/comparison.md).

Another network: --set 'model.name = "sparse-conv"'. With more time: --set 'schedule.steps = 20000'.
"""

from dataclasses import replace

from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.loading.augment_config import AugmentConfig
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.run.network import ModelRecipe
from training.run.optimizer import ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe
from training.weights.release import ReleaseRecipe

_AUGMENT = AugmentConfig(
    brightness=0.25, contrast=0.1, saturation=0.25, hue_deg=0.0, gray=0.0, blur=0.0, noise=0.0
)
_LOOP = LoopRecipe(clip_norm=20.0, ema_decay=0.98, checkpoint_every=100)

DEPTH = Recipe(
    terms="KITTI: CC BY-NC-SA 3.0 (non-commercial); rendered scenes: this project's",
    model=ModelRecipe("ssdnet-small-dep", config={"max_depth_m": 100.0}),
    data=DataRecipe(
        (
            KittiStreetsRecipe(path="kitti_streets", first=2, last=69, weight=0.5),
            KittiStreamRecipe(path="kitti_stream", last=49, weight=0.15),
            RenderedRecipe(path="rendered/kitti", scans=True, weight=0.35),
        ),
        augment=replace(
            _AUGMENT,
            crop=(160, 320),
            scale=(0.8, 1.4),
            lines=(64, 64, 32, 16),
            lidar_random=0.1,
            lidar_missing=0.0,  # some networks see nothing else
        ),
        workers=0,
        cache_gib=2.0,
    ),
    loss=LossConfig(
        class_weighting="none",
        weights={"semantic": 0.0, "semantic_boundary": 0.0, "semantic_depth": 0.0},
        depth_form="metric",
        depth_scales="finest",
        metric_l2=0.0,
        metric_log=10.0,
    ),
    schedule=ScheduleRecipe(steps=240, warmup_steps=20),
    loop=_LOOP,
)

SEMANTICS = Recipe(
    terms="CamVid: research use with citation",
    model=ModelRecipe("ssdnet-small-sem", trained_height=360),
    data=DataRecipe(
        (CamVidRecipe(path="camvid"),),
        augment=replace(_AUGMENT, crop=(160, 224), scale=(0.6, 1.2)),
        workers=0,
        cache_gib=1.0,
    ),
    # The boundary's term is about heads that most of these networks do not have.
    loss=LossConfig(class_weighting="sqrt_median", weights={"semantic_boundary": 0.03}),
    schedule=ScheduleRecipe(steps=400, warmup_steps=20),
    loop=_LOOP,
    release=ReleaseRecipe(logit_adjustment=0.75),
)

RECIPES = {
    "depth": ("Depth from random weights, alike for every network of the comparison.", DEPTH),
    "semantics": (
        "CamVid from random weights, alike for every network of the comparison.",
        SEMANTICS,
    ),
}
