"""A data set at another size."""

from training.datasets.sample import Sample, SampleSource
from training.loading.augment import resize


class ResizedSource:
    """Every frame of a data set brought to one (height, width), as `augment.resize` does it."""

    def __init__(self, source: SampleSource, size: tuple[int, int]) -> None:
        self._source = source
        self._size = size

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        return resize(self._source[index], self._size)
