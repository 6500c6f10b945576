"""ssdnet-lite on KITTI's depth completion benchmark, with classes from rendered streets.

The benchmark has none: they, and with them the boundaries, are learned beside it
(ssdnet-render rendered/train --scenes 500).
"""

from training.datasets.kitti_depth import KittiDepthRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.loading.augment_config import AugmentConfig
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe
from training.run.validation_recipe import ValidationRecipe

RECIPE = Recipe(
    terms="KITTI: CC BY-NC-SA 3.0 (non-commercial); rendered scenes: this project's",
    model=ModelRecipe(
        "ssdnet-lite", trained_height=375, pretrained="imagenet", config={"max_depth_m": 100.0}
    ),
    data=DataRecipe(
        (
            KittiDepthRecipe(path="kitti_depth", cameras=(2, 3), weight=0.7),
            RenderedRecipe(path="rendered/train", weight=0.3),
        ),
        augment=AugmentConfig(
            crop=(320, 640), scale=(0.8, 1.4), contrast=0.2, hue_deg=5.0, lidar_missing=0.05
        ),
        workers=8,
    ),
    loss=LossConfig(
        class_weighting="sqrt_median",
        weights={
            "depth": 0.05,  # as in lite.py: with a larger weight the depth loss dominates
            "semantic_iou": 0.3,
            "semantic_boundary": 0.05,
            "semantic_depth": 0.02,
        },
        depth_form="metric",
        depth_scales="finest",
    ),
    optimizer=OptimizerRecipe(learning_rate=1.5e-3),
    schedule=ScheduleRecipe(steps=60000, warmup_steps=500),
    loop=LoopRecipe(autocast="bf16", clip_norm=10.0),
    validation=ValidationRecipe(
        every=5000, source=(KittiDepthRecipe(path="kitti_depth", split="selection"),)
    ),
)
