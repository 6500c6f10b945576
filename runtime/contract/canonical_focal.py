"""Canonical depth: metres as a camera of one fixed focal length would see them.

An image magnified by s looks as if everything were s times nearer, so a network that was trained on
one camera misjudges the distances of another camera. Yin et al. 2023, "Metric3D: Towards zero-shot
metric 3D prediction from a single image" (ICCV), Sec. 3.2: the network works in depth * f_c / f,
where f_c is the focal length of one canonical camera and f that of the input image. The answer is
multiplied by f / f_c.
"""

import math
from typing import NamedTuple


class CameraScale(NamedTuple):
    """Conversion between metres and a network's depth, for one camera and one size of frames.

    Attributes:
        factor: f_c / f, from metres to canonical depth; 1 if f_c or f is not known.
        range_m: depth range in metres: no answer is farther, and farther returns are clipped to it.
        focal_length_px: focal length of the frame; None if it is not known, or the model does not
            use it.
    """

    factor: float
    range_m: float
    focal_length_px: float | None


def camera_scale(
    max_depth_m: float,
    canonical_focal_px: float | None,
    focal_length_px: float | None,
    *,
    frame_size: tuple[int, int],
    network_size: tuple[int, int],
) -> CameraScale:
    """Return the scale for a frame.

    The focal length is scaled with the frame to the network's size. If height and width are scaled
    differently, the geometric mean of both scales is used.

    Args:
        max_depth_m: range of the model, canonical metres.
        canonical_focal_px: canonical focal length of the model; None: it works in plain metres.
        focal_length_px: focal length of the frame; None: not known.
        frame_size: (height, width) of the frame.
        network_size: (height, width) at which the network runs.
    """
    if canonical_focal_px is None or focal_length_px is None:
        return CameraScale(1.0, max_depth_m, None)
    magnified = math.sqrt(math.prod(network_size) / math.prod(frame_size))
    factor = canonical_focal_px / (focal_length_px * magnified)
    return CameraScale(factor, max_depth_m / factor, focal_length_px)
