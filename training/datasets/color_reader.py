"""Labels in colours, as class ids."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import DatasetError
from training.datasets.class_list import Color
from training.datasets.files import read_rgb, require_size

# Number of unlisted colours in a picture from which they are mixtures, and those that are named.
_MIXED, _NAMED = 16, 3


class ColorReader:
    """Reads label files, RGB, as ids of a class table.

    Args:
        ids: the class id of each colour, 255 = ignored.
        where: what lists the colours, for messages.
        advice: what to do about a few other colours.
    """

    def __init__(self, ids: Mapping[Color, int], where: str, advice: str) -> None:
        self._where, self._advice = where, advice
        packed = {int.from_bytes(color, "big"): index for color, index in ids.items()}
        self._colors = np.array(sorted(packed), dtype=np.int32)
        self._ids = np.array([packed[color] for color in sorted(packed)], dtype=np.uint8)

    def read(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return the class ids, uint8 (H, W), of a picture; DatasetError for other colours."""
        label = read_rgb(path)
        require_size(path, label.shape, size)
        # The bytes blue, green, red and 0 are r << 16 | g << 8 | b as a little-endian integer.
        packed = cv2.cvtColor(label, cv2.COLOR_RGB2BGRA)
        packed[..., 3] = 0
        color = packed.view("<i4").ravel()
        # Neighbouring pixels mostly have the same colour, so each run of equal pixels is looked up
        # once.
        starts = np.flatnonzero(np.diff(color, prepend=-1))
        run, lengths = color[starts], np.diff(starts, append=color.size)
        index = np.searchsorted(self._colors, run).clip(max=len(self._colors) - 1)
        unlisted = self._colors[index] != run
        if unlisted.any():
            colors, places = np.unique(run[unlisted], return_inverse=True)
            shares = np.bincount(places, weights=lengths[unlisted]) / color.size
            often = np.argsort(-shares)[:_NAMED]
            named = (f"{tuple(int(colors[i]).to_bytes(3, 'big'))} {shares[i]:.2%}" for i in often)
            advice = "so many are mixtures, of smoothed edges or JPEG: export it without both"
            raise DatasetError(
                f"{path}: {len(colors)} colours are not in {self._where}, {shares.sum():.2%} of "
                f"the pixels ({', '.join(named)}): "
                f"{self._advice if len(colors) < _MIXED else advice}"
            )
        ids: NDArray[np.uint8] = np.repeat(self._ids[index], lengths)
        return ids.reshape(size)
