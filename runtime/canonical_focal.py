"""Canonical depth: metres as a camera of one fixed focal length would see them.

A picture magnified by s looks as if everything were s times nearer, so a network that learned from
one camera judges another's distances wrong. Yin et al. 2023, "Metric3D: Towards zero-shot metric 3D
prediction from a single image" (ICCV), Sec. 3.2: let it work in depth * f_c / f, f_c the focal
length of one canonical camera, f that of the picture at hand, and take the factor off its answer.
"""

import math


def canonical_factor(canonical_focal_px: float | None, focal_length_px: float | None) -> float:
    """Return f_c / f: metres times it are canonical depth; 1 where either is not known.

    canonical_focal_px: of the model, None = it works in plain metres. focal_length_px: of the
    picture as the network sees it.
    """
    if canonical_focal_px is None or focal_length_px is None:
        return 1.0
    return canonical_focal_px / focal_length_px


def focal_length_at(
    network_size: tuple[int, int], focal_length_px: float, frame_size: tuple[int, int]
) -> float:
    """Return the focal length [px] of a frame brought to another (height, width).

    The geometric mean of both axes, where they are magnified differently.
    """
    magnified = math.prod(network_size) / math.prod(frame_size)
    return focal_length_px * math.sqrt(magnified)
