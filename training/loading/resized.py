"""A data set at another size."""

from training.datasets.sample import Sample, SampleSource
from training.loading.augment import resize


class ResizedSource:
    """A data set whose frames are resized to one (height, width) by `augment.resize`."""

    def __init__(self, source: SampleSource, size: tuple[int, int]) -> None:
        self._source = source
        self._size = size

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        return resize(self._source[index], self._size)
