"""The frames of a data set, checked and at one size."""

import numpy as np

from runtime.errors import DatasetError
from training.datasets.sample import Sample, SampleSource, target_kind
from training.loading.augment import resize


class CheckedSource:
    """A data set whose targets have their type and size.

    The frames are resized to ``size`` by `augment.resize` if given.

    DatasetError names the reader and the frame of another.
    """

    def __init__(self, source: SampleSource, size: tuple[int, int] | None) -> None:
        self._source = source
        self._size = size

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        sample = self._source[index]
        for target, values in sample.targets.items():
            try:
                dtype, unlabelled, _ = target_kind(target)
            except ValueError as error:
                raise self._error(sample, f"a target {target!r}; {error}") from error
            found = type(values).__name__
            if isinstance(values, np.ndarray):
                found = f"{values.dtype} {values.shape}"
            expected = f"{dtype} {sample.size}"
            if found != expected:
                text = f"{target} = {found}; expected {expected}, {unlabelled:g} = unknown"
                raise self._error(sample, f"{text}. A set without this target must omit it")
        return sample if self._size is None else resize(sample, self._size)

    def _error(self, sample: Sample, text: str) -> DatasetError:
        reader = type(self._source).__name__
        return DatasetError(f"{sample.name}: the reader {reader} returned {text}.")
