"""Decoded frames kept in memory."""

from training.datasets.sample import Sample, SampleSource


class CachedSource:
    """A data set that decodes each frame once, as long as they fit into ``limit_bytes``.

    Later frames are decoded anew each time: none is dropped for another, since passes over a
    shuffled set would drop each of them just before it is wanted again. A worker process keeps its
    own frames.
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
    arrays = {
        id(array): array.nbytes
        for array in (
            sample.rgb,
            sample.sparse_depth,
            sample.depth,
            sample.semantic,
            sample.scan_line,
            sample.road_mask,
        )
        if array is not None
    }
    return sum(arrays.values())
