"""Class tables of the data sets that networks are trained with."""

from collections.abc import Mapping

from runtime.contract.contract import ClassInfo

# CamVid's eleven classes in the split and order of the SegNet papers (Brostow et al. 2009;
# Badrinarayanan et al. 2017); colours are RGB. The colours of pavement, sign, fence and car are
# those of Cityscapes, since CamVid's colours look alike over an image.
CAMVID_CLASSES: tuple[ClassInfo, ...] = (
    ClassInfo("sky", (128, 128, 128)),
    ClassInfo("building", (128, 0, 0)),
    ClassInfo("pole", (192, 192, 128)),
    ClassInfo("road", (128, 64, 128)),
    ClassInfo("pavement", (244, 35, 232)),
    ClassInfo("tree", (128, 128, 0)),
    ClassInfo("sign", (220, 220, 0)),
    ClassInfo("fence", (190, 153, 153)),
    ClassInfo("car", (0, 0, 142)),
    ClassInfo("pedestrian", (64, 64, 0)),
    ClassInfo("bicyclist", (0, 128, 192)),
)

# Cityscapes' 19 classes of evaluation, in the order of their trainIds (Cordts et al. 2016).
CITYSCAPES_CLASSES: tuple[ClassInfo, ...] = (
    ClassInfo("road", (128, 64, 128)),
    ClassInfo("sidewalk", (244, 35, 232)),
    ClassInfo("building", (70, 70, 70)),
    ClassInfo("wall", (102, 102, 156)),
    ClassInfo("fence", (190, 153, 153)),
    ClassInfo("pole", (153, 153, 153)),
    ClassInfo("traffic light", (250, 170, 30)),
    ClassInfo("traffic sign", (220, 220, 0)),
    ClassInfo("vegetation", (107, 142, 35)),
    ClassInfo("terrain", (152, 251, 152)),
    ClassInfo("sky", (70, 130, 180)),
    ClassInfo("person", (220, 20, 60)),
    ClassInfo("rider", (255, 0, 0)),
    ClassInfo("car", (0, 0, 142)),
    ClassInfo("truck", (0, 0, 70)),
    ClassInfo("bus", (0, 60, 100)),
    ClassInfo("train", (0, 80, 100)),
    ClassInfo("motorcycle", (0, 0, 230)),
    ClassInfo("bicycle", (119, 11, 32)),
)

# Virtual KITTI's 14 classes with the colours of its second edition (Cabon et al. 2020).
VIRTUAL_KITTI_CLASSES: tuple[ClassInfo, ...] = (
    ClassInfo("terrain", (210, 0, 200)),
    ClassInfo("sky", (90, 200, 255)),
    ClassInfo("tree", (0, 199, 0)),
    ClassInfo("vegetation", (90, 240, 0)),
    ClassInfo("building", (140, 140, 140)),
    ClassInfo("road", (100, 60, 100)),
    ClassInfo("guard rail", (250, 100, 255)),
    ClassInfo("traffic sign", (255, 255, 0)),
    ClassInfo("traffic light", (200, 200, 0)),
    ClassInfo("pole", (255, 130, 0)),
    ClassInfo("misc", (80, 80, 80)),
    ClassInfo("truck", (160, 60, 60)),
    ClassInfo("car", (255, 127, 80)),
    ClassInfo("van", (0, 139, 139)),
)

# The tables by their names in recipes.
CLASS_TABLES: Mapping[str, tuple[ClassInfo, ...]] = {
    "camvid": CAMVID_CLASSES,
    "cityscapes": CITYSCAPES_CLASSES,
    "virtual_kitti": VIRTUAL_KITTI_CLASSES,
}

# Cityscapes' seven categories, and the classes of every table that belong to each.
CATEGORIES: Mapping[str, frozenset[str]] = {
    "flat": frozenset({"road", "sidewalk", "pavement"}),
    "construction": frozenset({"building", "wall", "fence", "guard rail"}),
    "object": frozenset({"pole", "traffic light", "traffic sign", "sign"}),
    "nature": frozenset({"vegetation", "terrain", "tree"}),
    "sky": frozenset({"sky"}),
    "human": frozenset({"person", "rider", "pedestrian", "bicyclist"}),
    "vehicle": frozenset({"car", "truck", "bus", "train", "motorcycle", "bicycle", "van"}),
}


def numbered_classes(count: int) -> tuple[ClassInfo, ...]:
    """Return `count` (0..255) classes named `class_0` ... in the colours of PASCAL VOC.

    They serve networks whose class names are unknown.
    """
    return tuple(ClassInfo(f"class_{index}", voc_color(index)) for index in range(count))


def voc_color(index: int) -> tuple[int, int, int]:
    """Return the colour of a class in the palette of PASCAL VOC, without that of index 0."""
    value = index + 1  # VOC's index 0 is black, the colour of unlabelled pixels
    red, green, blue = (
        sum((value >> 3 * place + channel & 1) << 7 - place for place in range(8))
        for channel in range(3)
    )
    return red, green, blue
