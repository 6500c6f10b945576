"""The kinds of surface: `surfaces.py` has one function a kind."""

from enum import IntEnum

SurfaceKind = IntEnum(
    "SurfaceKind",
    "PLAIN ASPHALT PAVING GRASS FACADE ROOF FOLIAGE BARK METAL CAR_BODY CAR_SIDE_WINDOW CAR_GLASS "
    "WHEEL SIGN GLOW BRICKWORK PLANKS CLOTH BUS_SIDE STONE",
    start=0,
)
