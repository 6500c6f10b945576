"""The rows of the ablation, on rendered scenes (see docs/results.md).

For the network at the paper's size: --set 'model.name = "ssdnet"'.
"""

from dataclasses import replace
from typing import Any

from training.datasets.virtual_kitti import RenderedRecipe
from training.losses import LossConfig
from training.recipe import (
    DataRecipe,
    LoopRecipe,
    ModelRecipe,
    OptimizerRecipe,
    Recipe,
    ScheduleRecipe,
    ValidationRecipe,
    derive,
)
from training.recipes.paper import VKITTI

SSDNET = Recipe(
    terms="rendered scenes: this project's",
    model=ModelRecipe("ssdnet-small", trained_height=125, config={"max_depth_m": 100.0}),
    data=DataRecipe(
        (RenderedRecipe(path="train"),),
        augment=replace(VKITTI.data.augment, crop=(96, 320)),
        cache_gib=4.0,
    ),
    # With 1, the weight of the other terms, Eq. 8 and 11 favour one class everywhere and the
    # semantics never recover (row joint-weights-1).
    loss=LossConfig(semantic_boundary_weight=0.03, semantic_depth_weight=0.03),
    optimizer=OptimizerRecipe(),
    schedule=ScheduleRecipe(steps=800, warmup_steps=40),
    loop=LoopRecipe(autocast="bf16", ema_decay=0.99, checkpoint_every=200),
    # For those who add a set to watch.
    validation=ValidationRecipe(lidar="random:0.05"),
)


def _network(name: str, **config: Any) -> Recipe:
    """Return the recipe with another network or configuration."""
    return derive(SSDNET, model={"name": name, "config": {**SSDNET.model.config, **config}})


def _loss(**changes: Any) -> Recipe:
    """Return the recipe with another loss."""
    return derive(SSDNET, loss=changes)


def _joint_weights(weight: float, **changes: Any) -> Recipe:
    """Return the recipe with other weights of Eq. 8 and 11."""
    return _loss(semantic_boundary_weight=weight, semantic_depth_weight=weight, **changes)


#: Row -> its description and recipe.
ROWS = {
    "depth-gain": (
        "The sparse depth twenty times as strong at the input: as strong as the colours.",
        _network("ssdnet-small", sparse_depth_gain=20.0),
    ),
    "depth-gain-dep": (
        "SSDNet_Dep with the sparse depth twenty times as strong at the input.",
        _network("ssdnet-small-dep", sparse_depth_gain=20.0),
    ),
    "depth-weight-10": (
        "Eq. 4 with ten times the weight of the other terms.",
        _loss(depth_weight=10.0),
    ),
    "hard-disagreement": (
        "Eq. 7 as printed, on arg-max labels: no gradient to the semantic head.",
        _loss(disagreement="hard"),
    ),
    "joint-weights-01": (
        "Eq. 8 and 11 with a tenth of the weight of the other terms.",
        _joint_weights(0.1),
    ),
    "joint-weights-1": (
        "Eq. 8 and 11 with the weight of the other terms, Eq. 12 as printed.",
        _joint_weights(1.0),
    ),
    "paper-class-weights": (
        "Eq. 5's beta as printed, the share of the class: it weighs frequent classes up.",
        _loss(class_weighting="paper"),
    ),
    "ssdnet": ("The full network of the ablation, on rendered scenes.", SSDNET),
    "ssdnet-dep": (
        "SSDNet_Dep: no semantic decoder; classes serve only to find the boundaries.",
        _network("ssdnet-small-dep"),
    ),
    "ssdnet-dep-d": (
        "SSDNet_Dep_d: no semantic decoder, sparse depth alone as input.",
        _network("ssdnet-small-dep-d"),
    ),
    "ssdnet-dep-rgb": (
        "SSDNet_Dep_rgb: no semantic decoder, RGB alone as input.",
        _network("ssdnet-small-dep-rgb"),
    ),
    "ssdnet-ind": (
        "SSDNet_ind: the full network without the joint losses, Eq. 8 and 11.",
        _joint_weights(0.0),
    ),
    "ssdnet-sem": ("SSDNet_Sem: no depth decoder.", _network("ssdnet-small-sem")),
    "uncertainty": (
        "Weights of the terms, all 1, scaled by learned uncertainties (Kendall et al. 2018).",
        _joint_weights(1.0, weighting="uncertainty"),
    ),
    "ungated": (
        "B = 0: decoders of plain convolutions; the boundary is still predicted.",
        _network("ssdnet-small", boundary_gating=False),
    ),
}
