"""Decoded frames kept in memory."""

from training.datasets.sample import Sample, SampleSource


class CachedSource:
    """A data set that keeps decoded frames in memory, up to ``limit_bytes``.

    No frame is replaced by another: passes over a shuffled set would drop each frame just before it
    is used again. Each worker process has its own cache.
    """

    def __init__(self, source: SampleSource, *, limit_bytes: int) -> None:
        self._source = source
        self._free = limit_bytes
        self._kept: dict[int, Sample] = {}

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        if index in self._kept:
            return self._kept[index]
        sample = self._source[index]
        size = _bytes_of(sample)
        if size <= self._free:
            self._free -= size
            self._kept[index] = sample
        return sample


def _bytes_of(sample: Sample) -> int:
    arrays = (sample.rgb, sample.sparse_depth, sample.scan_line, *sample.targets.values())
    return sum({id(array): array.nbytes for array in arrays if array is not None}.values())
