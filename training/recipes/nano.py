"""ssdnet-nano with the encoder of lite, pruned further; --teacher ssdnet-lite, in three stages.

Crops, pairs of shifted views, the depth alone, which is the recipe nano-depth, too.
"""

from training.recipes import lite
from training.run.recipe import derive
from training.run.stages import Stage
from training.weights.release import add_offsets

CROPS = derive(
    lite.CROPS,
    model={"name": "ssdnet-nano", "config": {"canonical_focal_px": 721.5}},
    data={"batch_size": 6, "seed": 61, "augment": {"lidar_missing": 0.12, "lidar_random": 0.15}},
    loss={
        "weights": {
            "depth": 0.6,
            "distilled_semantic": 1.0,
            "distilled_depth": 2.0,
            "distilled_boundary": 0.5,
        }
    },
    # Pruning took more than half of the channels: the others learn, too, and fast.
    optimizer={"encoder_rate": 1e-3, "frozen": ()},
    schedule={"steps": 7000},
)

PAIRS = derive(
    CROPS,
    data={
        "batch_size": 3,
        "seed": 62,
        "augment": {"pair_shift": 32, "pair_lidar_missing": 0.25, "pair_lidar_false": 0.15},
    },
    loss={"weights": {"depth_consistency": 2.5, "depth_seam": 4.0, "semantic_consistency": 0.25}},
    optimizer={"learning_rate": 1.5e-3, "encoder_rate": 7e-4},
    validation={"every": 3500},
    release={"logit_adjustment": 0.75},
)

# Classes and boundaries do not change.
DEPTH = derive(
    lite.DEPTH,
    model={"name": "ssdnet-nano"},
    data={"seed": 202},
    schedule={"steps": 4500},
    validation={"every": 1500},
)

#: What the training frames then still found too often or too seldom (benchmarks/logit_offsets.py).
_OFFSETS = {"sky": 0.25, "building": 0.5, "pole": 1.0, "tree": 0.5, "fence": -1.0}

STAGES = (
    Stage("1-crops", CROPS),
    Stage("2-pairs", PAIRS, then=lambda network, _: add_offsets(network, _OFFSETS)),
    Stage("3-depth", DEPTH),
)
