"""The rows of the ablation, on rendered scenes (see docs/results.md).

For the network at the paper's size: --set 'model.name = "ssdnet"'.
"""

from dataclasses import replace

from training.datasets.virtual_kitti import RenderedRecipe
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.recipes.paper import VKITTI
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe, derive
from training.run.validation_recipe import ValidationRecipe

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
    loss=LossConfig(weights={"semantic_boundary": 0.03, "semantic_depth": 0.03}),
    optimizer=OptimizerRecipe(),
    schedule=ScheduleRecipe(steps=800, warmup_steps=40),
    loop=LoopRecipe(autocast="bf16", ema_decay=0.99, checkpoint_every=200),
    # For those who add a set to watch.
    validation=ValidationRecipe(lidar="random:0.05"),
)


def _joint_weights(weight: float) -> Recipe:
    """Return the recipe with other weights of Eq. 8 and 11."""
    return derive(SSDNET, loss={"weights": {"semantic_boundary": weight, "semantic_depth": weight}})


# Part of the network -> the description of the row with this part alone.
_PARTS = {
    "dep": "SSDNet_Dep: no semantic decoder; classes serve only to find the boundaries.",
    "dep-d": "SSDNet_Dep_d: no semantic decoder, sparse depth alone as input.",
    "dep-rgb": "SSDNet_Dep_rgb: no semantic decoder, RGB alone as input.",
    "sem": "SSDNet_Sem: no depth decoder.",
}
# Row -> its description and recipe.
ROWS = {
    "joint-weights-1": (
        "Eq. 8 and 11 with the weight of the other terms, Eq. 12 as printed.",
        _joint_weights(1.0),
    ),
    "paper-class-weights": (
        "Eq. 5's beta as printed, the share of the class: it weighs frequent classes up.",
        derive(SSDNET, loss={"class_weighting": "paper"}),
    ),
    "ssdnet": ("The full network of the ablation, on rendered scenes.", SSDNET),
    "ssdnet-ind": (
        "SSDNet_ind: the full network without the joint losses, Eq. 8 and 11.",
        _joint_weights(0.0),
    ),
    **{
        f"ssdnet-{part}": (text, derive(SSDNET, model={"name": f"ssdnet-small-{part}"}))
        for part, text in _PARTS.items()
    },
}
