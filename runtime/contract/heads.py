"""The heads of the networks: a table with one row for each head.

All code that handles answers reads this table: the contract, the signature check, post-processing,
references and their comparison, the writers and the drawing. A new head is therefore a new row,
here or in another package, which registers it as an entry point of `GROUP`.
"""

import math
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Literal

from runtime.base.entry_points import find_entry

# How a map is resized, see `runtime.contract.resize`.
ResizeRule = Literal["nearest", "bilinear", "surface"]


class Unit(StrEnum):
    """What the values of a head are."""

    CLASS_ID = "class id"
    METRES = "m"
    PROBABILITY = "probability"
    SCORE = "score"  # before the soft-max


class Difference(StrEnum):
    """How two answers of a head are compared."""

    EQUAL_SHARE = "agreement"  # share of pixels with the same value
    MEAN = "mean_abs"  # mean absolute difference
    ABSOLUTE = "max_abs"  # largest absolute difference
    RELATIVE = "max_relative"  # largest difference as a share of the largest value


class Panel(StrEnum):
    """How a head is drawn."""

    CLASSES = "classes"
    DEPTH = "depth"
    SHARE_OF_DEPTH = "share of depth"
    GRAY = "gray"  # 0..1


@dataclass(frozen=True)
class Head:
    """One output of a network: its meaning, and how the project handles it.

    For heads in metres, `least` and `most` are shares of the contract's `max_depth_m`. The
    `tolerance` of an absolute difference is a share of `max_depth_m`, or of 100 m if that is less.

    Attributes:
        name: name of the ONNX output, and in `Prediction.heads`.
        dtype: NumPy's name of the type.
        unit: the meaning of a value.
        least: smallest plausible value.
        most: largest plausible value. Class ids are limited by the class table.
        per_class: True if an answer is (C, H, W), one plane for each class, instead of (H, W).
        unlabelled: value of a pixel without a label in the targets of a training.
        resize: rule used if the network runs at another size than the frame, see
            `runtime.contract.resize`: "nearest" never mixes two values, "bilinear" takes the mean
            of the area when a side shrinks, "surface" mixes depths of one surface.
        difference: how two runtimes are compared, at an export and by `ssdnet-verify`.
        tolerance: smallest share of equal pixels, or else the largest (mean) difference between two
            runtimes.
        tolerance_int8: the limit between two runtimes for one 8-bit file: the largest share of
            pixels that differ, mean difference, or mean difference as a share of the mean value.
        saved_as: name for `ssdnet-run --save` and of the subfolder; "" = the head is not written.
            The unit decides how its files are encoded, see `runtime.drawing.encode`.
        panel: how the head is drawn; None: it is not drawn.
    """

    name: str
    dtype: Literal["uint8", "float32"]
    unit: Unit
    _: KW_ONLY
    least: float = -math.inf
    most: float = math.inf
    per_class: bool = False
    unlabelled: float = math.nan
    resize: ResizeRule
    difference: Difference
    tolerance: float
    tolerance_int8: float = 0.1
    saved_as: str = ""
    panel: Panel | None = None

    def bounds(self, max_depth_m: float) -> tuple[float, float]:
        """Return the smallest and the largest plausible value; -inf and inf mean no limit."""
        scale = max_depth_m if self.unit is Unit.METRES else 1.0
        return self.least * scale, self.most * scale

    def limit(self, max_depth_m: float) -> float:
        """Return `tolerance` in the unit of the difference."""
        is_metres = self.unit is Unit.METRES and self.difference is Difference.ABSOLUTE
        # Absolute errors have the limit of a range of 100 m, even if the range is larger.
        return self.tolerance * (min(max_depth_m, 100.0) if is_metres else 1.0)


# Pixels for which the boundary decoder gives a larger probability are object edges. At an edge,
# predicted depth passes from the near to the far surface through empty space. In a model with
# classes, `boundary` is half of this probability inside regions of one class.
EDGE_BOUNDARY = 0.5

# Group of the entry points with which other packages add heads, each under the head's name.
GROUP = "ssdnet.heads"


class HeadTable(dict[str, Head]):
    """Name -> head. A name that is missing is looked up in the installed packages, and kept.

    `in` and `[]` find such heads, with the ValueError of `find_entry`; an iteration yields only
    those that were found before.
    """

    def __missing__(self, name: str) -> Head:
        head = find_entry(GROUP, name, Head)
        if head is None:
            raise KeyError(name)
        if head.name != name:
            raise ValueError(
                f"the entry point {GROUP}: {name} has the head {head.name!r}: rename one"
            )
        return self.setdefault(name, head)

    def __contains__(self, name: object) -> bool:
        if super().__contains__(name):
            return True
        try:
            return isinstance(name, str) and self[name] is not None
        except KeyError:
            return False


# Name -> head, in the order of the contract.
HEADS = HeadTable(
    (head.name, head)
    for head in (
        Head(
            "semantic",
            "uint8",
            Unit.CLASS_ID,
            resize="nearest",
            difference=Difference.EQUAL_SHARE,
            tolerance=0.9995,  # rounding changes a class only where two classes tie
            tolerance_int8=0.04,  # ONNX Runtime 1.25 against 1.31: 0.012; another model: 0.10
            saved_as="semantic",
            panel=Panel.CLASSES,
            unlabelled=255,
        ),
        Head(
            "depth",
            "float32",
            Unit.METRES,
            resize="surface",
            difference=Difference.ABSOLUTE,
            # 5 mm at 100 m: about the step of a depth PNG; rounding in fp32 is a tenth of it.
            tolerance=5e-5,
            tolerance_int8=0.025,  # measured: 0.012; returns times 0.95: 0.03; another model: 0.06
            least=0.0,
            most=1.0,
            saved_as="depth",
            panel=Panel.DEPTH,
            unlabelled=0,
        ),
        # In a model with classes, it is halved inside regions of one class, so above 0.5 both heads
        # see a boundary.
        Head(
            "boundary",
            "float32",
            Unit.PROBABILITY,
            resize="bilinear",
            difference=Difference.MEAN,
            tolerance=2e-3,  # one pixel of another class halves or doubles 9 pixels
            tolerance_int8=0.02,  # measured: 0.006; another model: 0.08
            least=0.0,
            most=1.0,
            saved_as="boundary",
            panel=Panel.GRAY,
        ),
        Head(
            "depth_uncertainty",
            "float32",
            Unit.METRES,
            resize="nearest",
            difference=Difference.ABSOLUTE,
            tolerance=5e-5,
            tolerance_int8=0.1,  # measured: 0.045; another model: 0.4
            least=0.0,
            saved_as="uncertainty",
            panel=Panel.SHARE_OF_DEPTH,
        ),
        Head(
            "semantic_logits",
            "float32",
            Unit.SCORE,
            resize="bilinear",
            difference=Difference.RELATIVE,
            tolerance=1e-4,
            per_class=True,
        ),
    )
)
