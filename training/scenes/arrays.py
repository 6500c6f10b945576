"""Array types of the renderer."""

from dataclasses import dataclass, fields
from typing import Any, Self

from numpy.typing import NDArray

# Floating-point arrays; single precision wherever there is one row a pixel or triangle. NumPy's
# stubs cannot follow the precision through mixed arithmetic, so the type does not state it.
Floats = NDArray[Any]


@dataclass(frozen=True)
class Rows:
    """Base of the classes whose fields are arrays with as many rows each."""

    def take(self, rows: NDArray[Any]) -> Self:
        """The rows of these indices, or of a mask."""
        return type(self)(*(getattr(self, item.name)[rows] for item in fields(self)))
