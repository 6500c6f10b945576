"""Textures of vehicles: bodies with lamps and plates, windows, wheels."""

import numpy as np

from training.scenes.textures.patterns import band, hash01
from training.scenes.textures.surface import Points, Surface, matt, mix


def texture_car_body(p: Points) -> Surface:
    x, y, z = p.texture.T
    rear_x, front_x, radius, length, width, belt, door_x, seed = p.params.T
    f = p.footprint
    albedo, gloss = p.color.copy(), np.full(len(x), 0.05, dtype=np.float32)
    glow = np.zeros_like(albedo)
    half = width / 2
    on_side = np.abs(y) > half * 0.72
    nose, tail = x > length / 2 - 0.22, x < -length / 2 + 0.2
    handle = band(np.mod(x - door_x, 1.05) - 0.2, 0.09, f) * band(z - belt + 0.12, 0.02, f)
    grille = nose * band(np.abs(y), half * 0.55, f) * band(z - 0.48, 0.13, f)
    arches = [band(np.hypot(x - at, z - radius), radius + 0.07, f) for at in (rear_x, front_x)]
    doors = (door_x, rear_x + radius + 0.25, (door_x + front_x - radius - 0.1) / 2 + 0.42)
    darkness = (
        *(arch * on_side for arch in arches),
        band(z, 0.33, f),  # sills and skirts
        *(0.7 * band(x - at, 0.012, f) * on_side * (z < belt + 0.02) for at in doors),
        0.6 * handle * on_side * (np.abs(x) < length * 0.25),
        grille * 0.9,
        (nose | tail) * band(z - 0.36, 0.06, f) * (seed < 0.6),
        # The lid of the boot and the bonnet end in a thin dark gap.
        0.6 * tail * band(np.abs(y) - half * 0.62, 0.01, f) * (z > 0.55),
    )
    black = np.maximum.reduce(darkness)
    albedo = mix(albedo, (0.015, 0.015, 0.016), black)
    gloss *= 1 - 0.8 * black
    lamp_low = np.where(seed < 0.5, 0.58, 0.62)
    head = nose * band(np.abs(y) - half * 0.74, half * 0.2, f) * band(z - lamp_low - 0.07, 0.075, f)
    albedo = mix(albedo, (0.7, 0.7, 0.68), head)
    glow += (head * np.where(np.mod(seed * 7, 1) < 0.35, 0.9, 0.0))[:, None]
    rear_z = belt - 0.14
    back = tail * band(np.abs(y) - half * 0.82, half * 0.13, f) * band(z - rear_z, 0.1, f)
    albedo = mix(albedo, (0.42, 0.015, 0.012), back)
    red = np.array((1, 0.05, 0.03), np.float32)
    glow += (back * np.where(np.mod(seed * 13, 1) < 0.4, 1.2, 0.08))[:, None] * red
    middle = (x > length / 2 - 0.12) | (x < -length / 2 + 0.12)
    plate = middle * band(y, 0.26, f) * band(z - np.where(tail, 0.62, 0.42), 0.06, f)
    plate_color = np.where((tail & (seed < 0.4))[:, None], (0.7, 0.5, 0.05), (0.72, 0.72, 0.7))
    albedo = mix(albedo, plate_color, plate)
    letter = hash01(np.floor(y / 0.06), 5) < 0.7
    ink = plate * letter * band(np.mod(y, 0.06) - 0.03, 0.02, f)
    albedo = mix(albedo, (0.03, 0.03, 0.03), ink * 0.9)
    return Surface(albedo.astype(np.float32), gloss.astype(np.float32), glow.astype(np.float32))


def texture_car_side_window(p: Points) -> Surface:
    """Texture the side of a cabin; coordinates are (x, cabin height, 0 belt .. 1 roof edge)."""
    x, cabin, q = p.texture.T
    f = p.footprint
    tall = np.maximum(cabin, 0.05)
    pane = band((q - 0.5) * tall, 0.41 * tall - 0.02, f) * (cabin > 0.12)
    for k in (0, 1):
        pane *= 1 - band(x - p.params[:, k], 0.045, f)
    pane *= np.where(p.params[:, 3] != 0, (x > p.params[:, 3]).astype(np.float32), 1.0)
    albedo = mix(p.color, (0.016, 0.018, 0.02), pane)
    return matt(albedo.astype(np.float32), (0.05 + 0.04 * pane).astype(np.float32))


def texture_wheel(p: Points) -> Surface:
    x, z = p.texture[:, 0], p.texture[:, 2]
    radius = p.params[:, 0]
    reach = np.hypot(x, z)
    spokes = 0.5 + 0.5 * np.cos(np.arctan2(z, x) * np.where(p.params[:, 1] < 0.5, 5, 7))
    open_ = np.clip(1.4 - spokes * 1.6, 0, 1) * (reach > 0.18 * radius) * (reach < 0.6 * radius)
    rim = band(reach, 0.66 * radius, p.footprint) * (1 - 0.85 * open_)
    albedo = mix(np.full_like(p.color, 0.018), p.color, rim)
    return matt(albedo, (0.04 * rim).astype(np.float32))


def texture_bus_side(p: Points) -> Surface:
    x, y, z = p.texture.T
    height, length, width = p.params[:, 0], p.params[:, 1], p.params[:, 2]
    f = p.footprint / np.maximum(p.slant, 0.2)
    on_end = np.abs(x) > length / 2 - 0.02
    run, half_run = np.where(on_end, y, x), np.where(on_end, width / 2, length / 2)
    glass = band(z - 1.85, 0.55, f) * band(run, half_run - 0.18, f)
    upper = band(z - 3.3, 0.42, f) * band(run, half_run - 0.18, f) * (height > 3.5)
    pane = np.maximum(glass, upper) * np.where(on_end, 1.0, band(np.mod(x, 1.5) - 0.75, 0.7, f))
    albedo = p.color * np.where(z < 0.8, 0.85, 1.0)[:, None]
    albedo = mix(albedo, (0.6, 0.6, 0.58), band(z - 1.05, 0.12, f) * 0.8)
    albedo = mix(albedo, (0.015, 0.017, 0.02), pane)
    albedo = mix(albedo, (0.02, 0.02, 0.02), band(z, 0.42, f))
    return matt(albedo.astype(np.float32), (0.04 + 0.05 * pane).astype(np.float32))
