"""NumPy's .npy files, read without allocating more than they have."""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from runtime.checks import cut
from runtime.errors import InputError
from runtime.read_input import read_input

_READ_HEADER = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_npy(path: Path) -> NDArray[Any]:
    """Read a .npy file of at most `MAX_FILE_BYTES`; the array is not writable.

    Raises InputError if it cannot be read, is truncated or damaged, or holds Python objects.
    """
    content = read_input(path)
    file = io.BytesIO(content)
    try:
        shape, is_fortran, dtype = _READ_HEADER[npy.read_magic(file)](file)
        if min(shape, default=0) < 0:
            raise ValueError(f"its shape is {shape}")
        array = np.frombuffer(content, dtype, math.prod(shape), file.tell())
        return array.reshape(shape, order="F" if is_fortran else "C")
    except Exception as error:  # the header is a Python expression: parsing may raise any type
        raise InputError(
            f"{path} is not a .npy file of numbers, or is truncated ({cut(str(error), 200)})"
        ) from error
