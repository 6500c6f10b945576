"""The kinds of data sets that recipes can name.

A new kind needs its file and a line here, or an entry point of another package.
"""

from runtime.base.entry_points import find_entry
from training.datasets.camvid import CamVidRecipe
from training.datasets.cityscapes import CityscapesRecipe
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_depth import KittiDepthRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.recording import RecordingRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import RenderedRecipe, VirtualKitti1Recipe, VirtualKittiRecipe

DATASETS: dict[str, type[SourceRecipe]] = {
    "camvid": CamVidRecipe,
    "cityscapes": CityscapesRecipe,
    "folders": FoldersRecipe,
    "kitti-depth": KittiDepthRecipe,
    "kitti-stream": KittiStreamRecipe,
    "kitti-streets": KittiStreetsRecipe,
    "recording": RecordingRecipe,
    "rendered": RenderedRecipe,
    "virtual-kitti": VirtualKittiRecipe,
    "virtual-kitti-1": VirtualKitti1Recipe,
}
# Group of the entry points with which other packages add data sets.
GROUP = "ssdnet.datasets"


def find_dataset(kind: str) -> type[SourceRecipe] | None:
    """Return the options of a kind of data set; None if the kind is unknown.

    Raises ValueError if what a package registers is not a subclass of `SourceRecipe`.
    """
    if kind in DATASETS:
        return DATASETS[kind]
    found = find_entry(GROUP, kind, type)
    if found is None or issubclass(found, SourceRecipe):
        return found
    raise ValueError(f"the entry point {GROUP}: {kind} is no subclass of SourceRecipe")
