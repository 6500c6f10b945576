"""Names of the classes, streets, light variants and cameras of rendered frames.

Classes have the names and colours of Virtual KITTI 2 (Cabon et al. 2020); Pavement, Fence,
Pedestrian and Cyclist, which it lacks, have colours of their own.
"""

from enum import IntEnum, StrEnum
from typing import Self

StreetKind = StrEnum("StreetKind", "town residential avenue highway square")
# Light and weather of a scene.
Variant = StrEnum("Variant", "clone morning sunset overcast fog rain")
CameraName = StrEnum("CameraName", "kitti varied")


class SceneClass(IntEnum):
    """Class id of a surface, and its colour (RGB) in files."""

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
        member = int.__new__(cls, number)
        member._value_ = number
        member.color = color
        return member

    @property
    def category(self) -> str:
        """Name in files, such as "TrafficSign"."""
        return self.name.title().replace("_", "")
