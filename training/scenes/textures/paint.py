"""Road paint: lines, dashes, crossings and arrows in street coordinates."""

from dataclasses import dataclass

import numpy as np

from training.scenes.arrays import Floats


@dataclass(frozen=True)
class Stripe:
    """One painted rectangle in street coordinates, possibly broken into dashes.

    With `along` "s" it runs with the street, with "d" across it. `centre` is its position on the
    other axis [m].
    """

    along: str
    centre: float
    half_width: float
    start: float
    end: float
    period: float = 0.0
    painted: float = 1.0
    color: tuple[float, float, float] = (0.62, 0.62, 0.6)


def paint_cover(
    stripe: Stripe, s: Floats, d: Floats, footprint_s: Floats, footprint_d: Floats
) -> Floats:
    """Return the share, 0..1, of each point's footprint that the stripe covers."""
    run, across, f_run, f_across = s, d, footprint_s, footprint_d
    if stripe.along == "d":
        run, across, f_run, f_across = d, s, footprint_d, footprint_s
    cover = band(across - np.float32(stripe.centre), stripe.half_width, f_across)
    middle, half = (stripe.start + stripe.end) / 2, (stripe.end - stripe.start) / 2
    cover = cover * band(run - np.float32(middle), half, f_run)
    if stripe.period > 0:
        cycle = np.mod(run - np.float32(stripe.start), stripe.period)
        dash = stripe.period * stripe.painted
        sharp = band(cycle - np.float32(dash / 2), dash / 2, f_run)
        blend = np.clip(f_run / stripe.period, 0, 1)
        cover = cover * (sharp * (1 - blend) + stripe.painted * blend)
    return cover


def band(x: Floats, half_width: float | Floats, footprint: Floats) -> Floats:
    """Return the share of a pixel of this footprint at x that is within -half_width..half_width."""
    width = np.maximum(footprint, 1e-3)
    high = np.minimum(x + width / 2, half_width)
    low = np.maximum(x - width / 2, -half_width)
    return np.clip((high - low) / width, 0.0, 1.0)
