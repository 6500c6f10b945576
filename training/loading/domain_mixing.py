"""What one frame takes from another of the mixture: its style, or things that stand in it.

Rendered, recorded and labelled sets differ in light, colours and in what they show; a network that
can tell them apart learns what belongs to a set instead of what a thing looks like.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import fft

from runtime.resize import resize_image
from training.datasets.sample import Sample

#: Largest half side of the swapped square of the spectrum, as a share of the image's shorter side.
#: Yang and Soatto use 0.01 to 0.09.
MAX_BAND = 0.02
#: Things of fewer pixels are not pasted, nor those of which a larger share is behind a measurement.
LEAST_THING_PX, HIDDEN_SHARE = 20, 0.1


def swap_style(
    rgb: NDArray[np.uint8], other: NDArray[np.uint8], rng: Generator
) -> NDArray[np.uint8]:
    """Give an image the slow changes of colour and light of another one.

    The amplitudes of the lowest frequencies are those of the other image, the phases stay: Fourier
    domain adaptation (Yang and Soatto, CVPR 2020, Eq. 3).

    Args:
        rgb: uint8 (H, W, 3).
        other: uint8 (H', W', 3), RGB.
        rng: draws the width of the band.
    """
    height, width = rgb.shape[:2]
    half = int(rng.uniform(0, MAX_BAND) * min(height, width))
    spectrum, style = (
        fft.rfft2(image.astype(np.float32), axes=(0, 1))
        for image in (rgb, resize_image(other, (height, width)))
    )
    # Rows of negative frequencies are at the end; columns have none.
    band = np.ix_([*range(half + 1), *range(height - half, height)], range(half + 1))
    spectrum[band] = np.abs(style[band]) * np.exp(1j * np.angle(spectrum[band]))
    swapped: NDArray[np.float32] = fft.irfft2(spectrum, s=(height, width), axes=(0, 1))
    return np.clip(np.rint(swapped), 0, 255).astype(np.uint8)


def paste_things(sample: Sample, other: Sample, classes: Sequence[int]) -> Sample:
    """Paste the things of some classes from a frame with dense depth (as Olsson et al. 2021).

    A thing is a connected region of these classes, without what the sample's measurements are in
    front of; a thing that is mostly behind them is left out. It has its own image, class and depth;
    the LiDAR's returns at its place become returns from it. A sample without depth gets none.

    Args:
        sample: a frame with a sparse depth.
        other: one of the same size and unit of depth.
        classes: ids.
    """
    thing = np.isin(other.semantic, classes) & (other.depth > 0)
    fed = sample.sparse_depth
    hidden = (sample.depth > 0) & (sample.depth < other.depth)
    if fed is not None:
        hidden |= (fed > 0) & (fed < other.depth)
    count, region = cv2.connectedComponents(thing.astype(np.uint8), connectivity=8)
    sizes = np.bincount(region.ravel(), minlength=count)
    behind = np.bincount(region[hidden], minlength=count)
    kept = (sizes >= LEAST_THING_PX) & (behind <= HIDDEN_SHARE * sizes)
    kept[0] = False  # everything else
    pasted = kept[region] & ~hidden
    if not pasted.any():
        return sample
    road_mask = sample.road_mask
    return replace(
        sample,
        rgb=np.where(pasted[..., None], other.rgb, sample.rgb),
        semantic=np.where(pasted, other.semantic, sample.semantic),
        depth=np.where(pasted, other.depth, sample.depth) if sample.depth.any() else sample.depth,
        sparse_depth=None if fed is None else np.where(pasted & (fed > 0), other.depth, fed),
        road_mask=None if road_mask is None else np.where(pasted, np.uint8(0), road_mask),
    )
