"""Light and weather: the sun, the sky and the air of each variant of a scene."""

from dataclasses import dataclass

import numpy as np

from training.scenes.arrays import Floats
from training.scenes.names import Variant
from training.scenes.textures.patterns import fractal_noise


@dataclass(frozen=True)
class Weather:
    """Light of one variant; colours are linear RGB, directions are unit vectors.

    Attributes:
        sun: light of the sun; zero when it is hidden.
        sun_direction: direction to the sun.
        zenith, horizon: colours of the sky.
        cloud: share of the sky that is covered.
        cloud_seed: seed of the clouds.
        haze: extinction per metre.
        wet: 0 (dry) to 1 (soaked).
        exposure: exposure in f-stops.
        noise: strength of the sensor's noise.
    """

    sun_direction: tuple[float, float, float]
    sun: tuple[float, float, float]
    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    cloud: float
    cloud_seed: float
    haze: float
    wet: float
    exposure: float
    noise: float


_DARK = (0.0, 0.0, 0.0)
# For each variant: sun, zenith, horizon, range of cloud, haze.
_LIGHT = {
    "clone": ((3.4, 3.15, 2.8), (0.22, 0.42, 0.85), (0.75, 0.9, 1.1), (0.1, 0.7), 0.0009),
    "morning": ((2.7, 2.2, 1.6), (0.25, 0.4, 0.7), (0.95, 0.9, 0.85), (0.1, 0.6), 0.0012),
    "sunset": ((2.2, 1.3, 0.6), (0.22, 0.28, 0.5), (1.1, 0.72, 0.45), (0.2, 0.7), 0.0012),
    "overcast": (_DARK, (0.8, 0.84, 0.9), (0.95, 0.98, 1.02), (0.95, 1.0), 0.0010),
    "fog": (_DARK, (0.8, 0.82, 0.84), (0.82, 0.84, 0.86), (1.0, 1.0), 0.018),
    "rain": (_DARK, (0.45, 0.49, 0.55), (0.62, 0.65, 0.7), (0.95, 1.0), 0.006),
}


def draw_weather(variant: Variant, seed: int) -> Weather:
    """Return the light of a variant; the seed varies sun position, clouds and exposure."""
    rng = np.random.default_rng([seed, 2, list(Variant).index(variant)])
    azimuth = rng.uniform(0, 2 * np.pi)
    low, high = {"clone": (30, 60), "morning": (12, 28), "sunset": (6, 15)}.get(variant, (40, 50))
    height = np.deg2rad(rng.uniform(low, high))
    flat, up = np.cos(height), float(np.sin(height))
    sun, zenith, horizon, cloud, haze = _LIGHT[variant]
    haze *= rng.uniform(0.6, 1.5)
    return Weather(
        (float(flat * np.cos(azimuth)), float(flat * np.sin(azimuth)), up),
        sun,
        zenith,
        horizon,
        cloud=rng.uniform(*cloud),
        cloud_seed=rng.uniform(0, 200),
        haze=haze,
        wet=rng.uniform(0.6, 1.0) if variant == "rain" else 0.0,
        exposure=rng.normal(0.1, 0.4),
        noise=rng.uniform(0.004, 0.014),
    )


def sky_color(weather: Weather, direction: Floats, *, detail: bool = True) -> Floats:
    """Return the radiance (n, 3) of the sky along unit directions (n, 3); clouds if `detail`."""
    up = np.clip(direction[:, 2], 0, 1)
    blend = np.power(1 - up, 4)[:, None]
    colors = weather.zenith, weather.horizon, weather.sun
    zenith, horizon, sun = np.asarray(colors, np.float32)
    color = zenith * (1 - blend) + horizon * blend
    towards_sun = np.clip(direction @ np.asarray(weather.sun_direction, np.float32), 0, 1)
    shine = 0.25 * towards_sun**8 + (6.0 * towards_sun**900 if detail else 0)
    color = color + shine[:, None] * sun
    if not detail:
        return np.asarray(color)
    # Clouds are on a plane overhead, so they are denser towards the horizon.
    plane = direction[:, :2] / (up + 0.09)[:, None]
    seed = np.float32(weather.cloud_seed)
    density = fractal_noise(plane[:, 0] + seed, plane[:, 1], wavelength=1.9, octaves=5)
    cover = np.clip((density + 1.15 * weather.cloud - 0.62) * 2.6, 0, 1)
    lit = 0.72 + 0.28 * np.clip(0.5 - density, 0, 1)
    grey = 0.5 * horizon + 0.24 * sun + 0.45 * zenith.mean()
    cloud = (lit + 0.1 * density)[:, None] * grey
    cover = (cover * np.clip(up * 9, 0.15, 1) * 0.9)[:, None]
    return np.asarray(color * (1 - cover) + cloud * cover)
