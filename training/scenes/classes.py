"""Names, ids and colours of the classes of rendered frames.

Names and colours are those of Virtual KITTI 2 (Cabon et al. 2020) where it has the class;
Pavement, Fence, Pedestrian and Cyclist are added with colours of their own.
"""

from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray


class SceneClass(IntEnum):
    """Class id of a surface, an index into `CLASS_TABLE` and `class_colors()`, and its colour."""

    SKY = 0, (90, 200, 255)
    TERRAIN = 1, (210, 0, 200)
    TREE = 2, (0, 199, 0)
    VEGETATION = 3, (90, 240, 0)
    BUILDING = 4, (140, 140, 140)
    ROAD = 5, (100, 60, 100)
    GUARD_RAIL = 6, (250, 100, 255)
    TRAFFIC_SIGN = 7, (255, 255, 0)
    TRAFFIC_LIGHT = 8, (200, 200, 0)
    POLE = 9, (255, 130, 0)
    MISC = 10, (80, 80, 80)
    TRUCK = 11, (160, 60, 60)
    CAR = 12, (255, 127, 80)
    VAN = 13, (0, 139, 139)
    PAVEMENT = 14, (0, 0, 192)
    FENCE = 15, (64, 64, 128)
    PEDESTRIAN = 16, (220, 20, 60)
    CYCLIST = 17, (0, 128, 192)

    color: tuple[int, int, int]

    def __new__(cls, number: int, color: tuple[int, int, int]) -> Self:
        """Make a member of this id."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.color = color
        return member


#: Names, as in files, and colours by id.
CLASS_TABLE: tuple[tuple[str, tuple[int, int, int]], ...] = tuple(
    (item.name.title().replace("_", ""), item.color) for item in SceneClass
)


def class_colors() -> NDArray[np.uint8]:
    """Colour of every class: (number of classes, 3) uint8, RGB, indexed by `SceneClass`."""
    return np.array([color for _, color in CLASS_TABLE], dtype=np.uint8)
