"""The colours of labels by name, as options of commands take them."""

from typing import Literal

# PASCAL VOC's, in the order of the ids, or those of a table in `models.CLASS_TABLES`.
Palette = Literal["voc", "camvid", "cityscapes", "virtual_kitti"]
PALETTE_HELP = (
    "Colours of labels: PASCAL VOC's in the order of the ids, or those of a table by name."
)
