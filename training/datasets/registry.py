"""The kinds of data sets that recipes can name.

A new kind needs its file and a line here, or an entry point of another package.
"""

from models import CLASS_TABLES
from runtime.base.entry_points import find_entry, list_entries
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

    Raises ValueError if what a package registers is not a subclass of `SourceRecipe`, or has labels
    of an unknown table, and in the cases of `find_entry`.
    """
    found = find_entry(GROUP, kind, type, DATASETS)
    if found is None:
        return None
    if not issubclass(found, SourceRecipe):
        raise ValueError(f"the entry point {GROUP}: {kind} is no subclass of SourceRecipe")
    if found.labelled and found.labelled not in CLASS_TABLES:
        raise ValueError(
            f"the entry point {GROUP}: {kind} has labelled = {found.labelled!r}; expected one of "
            f"{', '.join(CLASS_TABLES)}, or none for labels of `model.classes`"
        )
    return found


def list_datasets() -> list[str]:
    """Return the names of all kinds, for messages."""
    return list_entries(GROUP, DATASETS)
