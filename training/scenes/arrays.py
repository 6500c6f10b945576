"""Array types of the renderer."""

from dataclasses import dataclass, fields
from typing import Any, Self

from numpy.typing import NDArray

# Floating-point arrays, in single precision if there is one row per pixel or triangle. NumPy's
# stubs cannot follow the precision through mixed arithmetic, so the type does not state it.
Floats = NDArray[Any]


@dataclass(frozen=True)
class Rows:
    """Base of the classes whose fields are arrays with the same number of rows."""

    def take(self, rows: NDArray[Any]) -> Self:
        """Return the rows with these indices, or of a mask."""
        return type(self)(*(getattr(self, item.name)[rows] for item in fields(self)))
