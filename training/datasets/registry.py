"""The kinds of data sets that recipes know. A new one: its file, and a line here."""

from training.datasets.camvid import CamVidRecipe
from training.datasets.cityscapes import CityscapesRecipe
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_depth import KittiDepthRecipe
from training.datasets.kitti_raw import KittiRawRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import RenderedRecipe, VirtualKitti1Recipe, VirtualKittiRecipe

DATASETS: dict[str, type[SourceRecipe]] = {
    "camvid": CamVidRecipe,
    "cityscapes": CityscapesRecipe,
    "folders": FoldersRecipe,
    "kitti-depth": KittiDepthRecipe,
    "kitti-raw": KittiRawRecipe,
    "kitti-stream": KittiStreamRecipe,
    "kitti-streets": KittiStreetsRecipe,
    "rendered": RenderedRecipe,
    "virtual-kitti": VirtualKittiRecipe,
    "virtual-kitti-1": VirtualKitti1Recipe,
}
