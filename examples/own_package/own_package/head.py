"""The head `drivable`."""

from runtime import Difference, Head, Panel, Unit

DRIVABLE = Head(
    "drivable",
    "float32",
    Unit.PROBABILITY,
    resize="bilinear",
    difference=Difference.ABSOLUTE,
    tolerance=4e-4,
    least=0.0,
    most=1.0,
    saved_as="free-space",
    panel=Panel.GRAY,
)
