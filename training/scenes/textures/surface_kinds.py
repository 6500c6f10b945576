"""The kinds of surface of the shader."""

from enum import IntEnum


class SurfaceKind(IntEnum):
    """How a surface is textured; `surfaces.py` has one function a kind."""

    PLAIN = 0
    ASPHALT = 1
    PAVING = 2
    GRASS = 3
    FACADE = 4
    ROOF = 5
    FOLIAGE = 6
    BARK = 7
    METAL = 8
    CAR_BODY = 9
    CAR_SIDE_WINDOW = 10
    CAR_GLASS = 11
    WHEEL = 12
    SIGN = 13
    GLOW = 14
    BRICKWORK = 15
    PLANKS = 16
    CLOTH = 17
    BUS_SIDE = 18
    STONE = 19
