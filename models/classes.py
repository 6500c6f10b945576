"""Class tables that networks of this project are trained with."""

from runtime.contract import ClassInfo

#: CamVid's eleven classes in the split and order of the SegNet papers (Brostow et al. 2009;
#: Badrinarayanan et al. 2017); colours are RGB.
CAMVID_CLASSES: tuple[ClassInfo, ...] = (
    ClassInfo("sky", (128, 128, 128)),
    ClassInfo("building", (128, 0, 0)),
    ClassInfo("pole", (192, 192, 128)),
    ClassInfo("road", (128, 64, 128)),
    ClassInfo("pavement", (0, 0, 192)),
    ClassInfo("tree", (128, 128, 0)),
    ClassInfo("sign", (192, 128, 128)),
    ClassInfo("fence", (64, 64, 128)),
    ClassInfo("car", (64, 0, 128)),
    ClassInfo("pedestrian", (64, 64, 0)),
    ClassInfo("bicyclist", (0, 128, 192)),
)


def numbered_classes(count: int) -> tuple[ClassInfo, ...]:
    """Return ``count`` classes named ``class_0`` ... with distinct, fixed colours.

    For networks whose class names are not known. Colours follow the bit-interleaved palette
    of PASCAL VOC. ``count`` is 0..255.
    """
    return tuple(ClassInfo(f"class_{index}", _voc_color(index)) for index in range(count))


def _voc_color(index: int) -> tuple[int, int, int]:
    channels = [0, 0, 0]
    value = index + 1  # VOC's index 0 is black, which reads as "nothing"
    for bit in range(7, -1, -1):
        for channel in range(3):
            channels[channel] |= ((value >> channel) & 1) << bit
        value >>= 3
    return channels[0], channels[1], channels[2]
