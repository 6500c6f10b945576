"""Names, ids and colours of the classes of rendered frames.

Names and colours are those of Virtual KITTI 2 (Cabon et al. 2020) where it has the class;
Pavement, Fence, Pedestrian and Cyclist are added with colours of their own.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class SceneClass(IntEnum):
    """Class id of a surface, an index into `CLASS_TABLE` and `class_colors()`."""

    SKY = 0
    TERRAIN = 1
    TREE = 2
    VEGETATION = 3
    BUILDING = 4
    ROAD = 5
    GUARD_RAIL = 6
    TRAFFIC_SIGN = 7
    TRAFFIC_LIGHT = 8
    POLE = 9
    MISC = 10
    TRUCK = 11
    CAR = 12
    VAN = 13
    PAVEMENT = 14
    FENCE = 15
    PEDESTRIAN = 16
    CYCLIST = 17


CLASS_TABLE: tuple[tuple[str, tuple[int, int, int]], ...] = (
    ("Sky", (90, 200, 255)),
    ("Terrain", (210, 0, 200)),
    ("Tree", (0, 199, 0)),
    ("Vegetation", (90, 240, 0)),
    ("Building", (140, 140, 140)),
    ("Road", (100, 60, 100)),
    ("GuardRail", (250, 100, 255)),
    ("TrafficSign", (255, 255, 0)),
    ("TrafficLight", (200, 200, 0)),
    ("Pole", (255, 130, 0)),
    ("Misc", (80, 80, 80)),
    ("Truck", (160, 60, 60)),
    ("Car", (255, 127, 80)),
    ("Van", (0, 139, 139)),
    ("Pavement", (0, 0, 192)),
    ("Fence", (64, 64, 128)),
    ("Pedestrian", (220, 20, 60)),
    ("Cyclist", (0, 128, 192)),
)


def class_colors() -> NDArray[np.uint8]:
    """Colour of every class: (number of classes, 3) uint8, RGB, indexed by `SceneClass`."""
    return np.array([color for _, color in CLASS_TABLE], dtype=np.uint8)
