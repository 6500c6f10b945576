"""Array types of the renderer."""

from typing import Any

from numpy.typing import NDArray

#: Floating-point arrays; single precision wherever there is one row a pixel or triangle. NumPy's
#: stubs cannot follow the precision through mixed arithmetic, so the type does not state it.
Floats = NDArray[Any]
