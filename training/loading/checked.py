"""The frames of a data set, checked and at one size."""

import numpy as np

from runtime.errors import DatasetError
from training.datasets.sample import Sample, SampleSource
from training.loading.augment import resize

#: Target of a sample -> type, and what it holds.
_TARGETS = {
    "depth": (np.float32, "metres, 0 = unknown"),
    "semantic": (np.uint8, "class ids, 255 = unknown"),
}


class CheckedSource:
    """A data set whose frames have their targets, resized to ``size`` by `augment.resize` if given.

    DatasetError names the reader and the frame without one.
    """

    def __init__(self, source: SampleSource, size: tuple[int, int] | None) -> None:
        self._source = source
        self._size = size

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        sample = self._source[index]
        for target, (dtype, meaning) in _TARGETS.items():
            values = getattr(sample, target)
            found = type(values).__name__
            if isinstance(values, np.ndarray):
                found = f"{values.dtype} {values.shape}"
            expected = f"{np.dtype(dtype)} {sample.size}"
            if found != expected:
                raise DatasetError(
                    f"{sample.name}: the reader {type(self._source).__name__} returned {target} = "
                    f"{found}; expected {expected}, {meaning}. A set without it returns it unknown "
                    "everywhere."
                )
        return sample if self._size is None else resize(sample, self._size)
