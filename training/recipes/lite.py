"""ssdnet-lite with an encoder that begins with weights of ImageNet, in five stages.

Single crops; pairs of shifted views, some without LiDAR or with false returns; the same with a
narrower trunk; with a larger weight of depth; the depth alone, which is the recipe lite-depth, too.
`rendered/kitti` and `rendered/varied` are made by ssdnet-render; the model card has the commands.
"""

from dataclasses import replace

from models import SSDNetLiteConfig
from training.datasets.camvid import CamVidRecipe
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.loading.augment_config import AugmentConfig
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.losses.terms import DEPTH_ALONE
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe, derive
from training.run.stages import Stage
from training.run.validation_recipe import ValidationRecipe
from training.weights.prune import prune_trunk
from training.weights.release import ReleaseRecipe, add_offsets

_CAMVID = CamVidRecipe(path="camvid", weight=0.3)
_STREETS = KittiStreetsRecipe(path="kitti_streets", first=2, last=69, weight=0.26)
_LABELLED = FoldersRecipe(
    path="kitti_labelled",
    rgb="image_02",
    labels="semantic",
    ignore=11,
    intrinsics=(721.5, 721.5, 609.6, 172.9),
    weight=0.09,
)
# Labels made by a network, here and in the next three: trucks, trees, other places and skies.
_STREAM = KittiStreamRecipe(path="kitti_stream", last=49, weight=0.03, semantic_weight=0.3)
_DRIVE = KittiStreamRecipe(path="kitti_drive_0009", last=29, weight=0.03, semantic_weight=0.3)
_OBJECT = KittiStreamRecipe(path="kitti_object", weight=0.03, semantic_weight=0.3)
_BOSTON = FoldersRecipe(
    path="nuscenes_boston",
    rgb="image",
    labels="pseudo_semantic",
    label_classes="cityscapes",
    semantic_weight=0.3,
    intrinsics=(633.0, 633.0, 400.0, 225.0),
    weight=0.05,
)
_RENDERED = RenderedRecipe(path="rendered/kitti", scans=True, weight=0.07)
_VARIED = RenderedRecipe(path="rendered/varied", scans=True, scale=(0.5, 1.5), weight=0.14)
VALIDATION_STREETS = KittiStreetsRecipe(path="kitti_streets", first=70, last=98)

CROPS = Recipe(
    # Terms of the data pass to the weights; those of ImageNet are added to them.
    terms="KITTI: CC BY-NC-SA 3.0 (non-commercial); nuScenes: CC BY-NC-SA 4.0 (non-commercial); "
    "CamVid: research use with citation; rendered scenes: this project's",
    model=ModelRecipe(
        "ssdnet-lite",
        trained_height=400,  # pictures of 360 and 375 rows, magnified by 1.06 on average
        pretrained="imagenet",
        # KITTI's camera at the size of its frames; all channels of the trunk.
        config={"canonical_focal_px": 721.5, "encoder_widths": []},
    ),
    data=DataRecipe(
        (_CAMVID, _STREETS, _LABELLED, _STREAM, _DRIVE, _OBJECT, _BOSTON, _RENDERED, _VARIED),
        augment=AugmentConfig(
            crop=(256, 384),
            rare_crops=0.5,
            scale=(0.6, 1.6),
            brightness=0.4,
            contrast=0.2,
            blur=0.05,
            noise=0.05,
            lines=(64, 64, 32, 16, 16, 8, 8, 4, 4, 4),  # four are hardest
            # Depth from the image alone, and from few returns, is learned, too. Black cars return
            # nothing.
            lidar_missing=0.2,
            lidar_random=0.2,
            random_share=(0.002, 0.08),
            lidar_absorbed=0.25,
            lidar_misaligned=0.1,
            lidar_dropout=0.1,
        ),
        batch_size=4,
        cache_gib=4.0,
        seed=51,
        sky_depth_m=100.0,
        rare_classes=("pole", "sign", "fence", "pedestrian", "bicyclist"),
    ),
    loss=LossConfig(
        class_weighting="sqrt_median",
        semantic_grid="head",
        weights={
            "semantic_iou": 1.0,
            "semantic_boundary": 0.05,
            "semantic_depth": 0.02,
            "depth": 0.2,
            "road": 0.3,
        },
        depth_form="metric",
        depth_scales="finest",
        metric_l2=0.0,
        metric_log=20.0,  # near depth, which is most of the image, to a per cent
    ),
    optimizer=OptimizerRecipe(
        encoder_rate=4e-4, frozen=("encoder.stem", "encoder.stride2", "encoder.stride4")
    ),
    schedule=ScheduleRecipe(steps=4000, warmup_steps=100),
    loop=LoopRecipe(clip_norm=20.0, ema_decay=0.998, checkpoint_every=100),
    validation=ValidationRecipe(
        every=2000,
        lidar="64",
        pictures=0,
        source=(CamVidRecipe(path="camvid", split="val"), VALIDATION_STREETS),
    ),
)

PAIRS = derive(
    CROPS,
    data={
        "batch_size": 3,
        "seed": 53,
        "augment": {"pair_shift": 32, "pair_lidar_missing": 0.3, "pair_lidar_false": 0.15},
    },
    loss={
        "weights": {
            "depth": 0.3,
            "depth_consistency": 2.0,
            "depth_seam": 4.0,
            "semantic_consistency": 0.25,
        }
    },
    optimizer={"learning_rate": 1.5e-3, "encoder_rate": 3e-4},
    schedule={"steps": 5500},
    validation={"every": 2750},
    release={"logit_adjustment": 0.75},
)

# Everything but the first layers of the pruned trunk is trained on.
NARROW = derive(
    PAIRS,
    model={"config": {"canonical_focal_px": 721.5}},
    data={"seed": 54},
    optimizer={"learning_rate": 1.2e-3, "frozen": ("encoder.stem", "encoder.stride2")},
    schedule={"steps": 11000},
)

# The same with more of the returns and a larger weight of depth.
JOINT = derive(
    NARROW,
    data={
        "seed": 71,
        "augment": {"lidar_missing": 0.12, "lidar_random": 0.15, "pair_lidar_missing": 0.25},
    },
    loss={"weights": {"depth": 1.0, "depth_consistency": 2.5, "road": 0.6}},
    schedule={"steps": 8000},
)

# Boundaries and the classes at stride 2 alone, mostly by the answers of a teacher: the encoder and
# the coarser decoder of the classes stay as they are, and with them what the depth reads.
CLASSES = derive(
    CROPS,
    model={"config": {"canonical_focal_px": 721.5}},
    data={
        "seed": 301,
        "source": (_CAMVID, _STREETS, _LABELLED, _STREAM, _DRIVE, _OBJECT, _BOSTON),
        "augment": {"lidar_missing": 0.4},
    },
    loss={
        "weights": {
            "distilled_semantic": 2.0,
            "distilled_boundary": 1.0,
            "semantic": 0.5,
            "semantic_iou": 0.5,
            "semantic_boundary": 0.0,
            "semantic_depth": 0.0,
            "boundary": 0.0,
            "depth": 0.0,
            "road": 0.15,
        }
    },
    optimizer={
        "learning_rate": 2e-3,
        "encoder_rate": None,
        "frozen": ("encoder", "context", "semantic_decoder", "depth_decoder", "surface_depth"),
    },
    schedule={"steps": 700, "warmup_steps": 30},
    validation={"every": 700},
)

# The depth alone; classes and boundaries do not change. The truth of the streets is of two kinds,
# accumulated scans and the returns that are not fed: the one has cars as closed models.
DEPTH = derive(
    JOINT,
    model={"config": {"canonical_focal_px": 721.5, "judges_picture": True}},
    data={
        "batch_size": 4,
        "seed": 201,
        "rare_classes": (),
        "augment": {
            "rare_crops": 0.0,
            "lines": (64, 64, 32, 32, 16, 16, 8, 4, 4, 4),
            "lidar_absorbed": 0.3,
            "lidar_missing": 0.1,
            "lidar_random": 0.4,
            "pair_lidar_missing": 0.2,
            # Else the decoder knows the depth of the training streets from their pictures.
            "world_scale": (0.6, 1.6),
        },
        "source": (
            replace(_STREETS, weight=0.22),
            replace(_STREETS, truth="scan", name="streets, scans", weight=0.3),
            replace(_STREAM, weight=0.05, semantic_weight=1.0),
            replace(_DRIVE, weight=0.06, semantic_weight=1.0),
            replace(_OBJECT, weight=0.05, semantic_weight=1.0),
            # Rendered scenes pay for scans of few lines, and hold the depth of real rigs back: few.
            # With the parallax of a LiDAR beside the camera, as on most cars, and without.
            replace(_VARIED, weight=0.05),
            replace(_VARIED, weight=0.03, scans=False, scale=None),
        ),
    },
    # A little squared error hedges at edges. Of 0.1 and more, few-line scans dominate the gradient.
    loss={
        "weights": {
            **DEPTH_ALONE,
            "depth_uncertainty": 0.2,
            "depth_consistency": 1.0,
            "depth_seam": 2.0,
        },
        "class_weighting": "none",
        "metric_l2": 0.02,
    },
    optimizer={
        "learning_rate": 1.5e-3,
        "frozen": ("encoder", "context", "boundary", "semantic", "surface_depth.embed"),
    },
    schedule=ScheduleRecipe(steps=3600, warmup_steps=50),
    loop={"ema_decay": 0.99},
    validation={"every": 1200, "source": (VALIDATION_STREETS,)},
    release=ReleaseRecipe(),
)

# The blocks of the trunk lose a third of their channels, which makes it faster.
_WIDTHS = SSDNetLiteConfig().encoder_widths
#: What the training frames then still found too often or too seldom (benchmarks/logit_offsets.py).
_OFFSETS = {"sky": 0.5, "building": 0.5, "pole": 0.5, "road": -0.5, "fence": -1, "bicyclist": -1.5}
STAGES = (
    Stage("1-crops", CROPS),
    Stage("2-pairs", PAIRS, then=lambda network, pictures: prune_trunk(network, _WIDTHS, pictures)),
    Stage("3-narrow", NARROW),
    Stage("4-joint", JOINT, then=lambda network, _: add_offsets(network, _OFFSETS)),
    Stage("5-depth", DEPTH),
)
