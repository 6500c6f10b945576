"""The kinds of data sets that recipes know. A new one: its file, and a line here."""

from training.datasets.camvid import CamVidRecipe
from training.datasets.cityscapes import CityscapesRecipe
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_depth import KittiDepthRecipe
from training.datasets.kitti_raw import KittiRawRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.rendered_scenes import RenderedOnTheFlyRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import (
    RenderedRecipe,
    VirtualKitti1Recipe,
    VirtualKittiRecipe,
)

DATASETS: dict[str, type[SourceRecipe]] = {
    "camvid": CamVidRecipe,
    "cityscapes": CityscapesRecipe,
    "folders": FoldersRecipe,
    "kitti_depth": KittiDepthRecipe,
    "kitti_raw": KittiRawRecipe,
    "kitti_stream": KittiStreamRecipe,
    "kitti_streets": KittiStreetsRecipe,
    "rendered": RenderedRecipe,
    "rendered_on_the_fly": RenderedOnTheFlyRecipe,
    "virtual_kitti": VirtualKittiRecipe,
    "virtual_kitti_1": VirtualKitti1Recipe,
}
