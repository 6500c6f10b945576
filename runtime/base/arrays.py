"""Arrays by the type of their elements, and sizes; docstrings state shapes and units."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Int64 = NDArray[np.int64]
Indices = NDArray[np.intp]

Size = tuple[int, int]  # (height, width)
