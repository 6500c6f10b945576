"""Textures of buildings: façades with windows, shop fronts, bricks, roofs, boards."""

import numpy as np

from training.scenes.arrays import Floats
from training.scenes.textures.patterns import band, fractal_noise, hash01
from training.scenes.textures.surface import Points, Surface, matt, mix

# Height and width of a brick with its mortar [m].
_TALL, _WIDE = 0.075, 0.225


def _bricks(u: Floats, v: Floats, color: Floats, footprint: Floats) -> Floats:
    row = np.floor(v / _TALL)
    shifted = u / _WIDE + 0.5 * np.mod(row, 2)
    column = np.floor(shifted)
    fade = np.clip(1.3 - footprint / _TALL, 0, 1)
    tone = 1 + 0.5 * (hash01(row, column, 5) - 0.5) * fade
    in_row = band((v / _TALL - row - 0.5) * _TALL, _TALL * 0.43, footprint)
    mortar = 1 - in_row * band((shifted - column - 0.5) * _WIDE, _WIDE * 0.47, footprint)
    tone += 0.12 * fractal_noise(u, v, wavelength=2.5, octaves=2)
    return mix(color * tone[:, None], (0.38, 0.35, 0.31), mortar * fade * 0.7)


def texture_brickwork(p: Points) -> Surface:
    u = p.texture[:, 0] + p.texture[:, 1]
    return matt(_bricks(u, p.texture[:, 2], p.color, p.footprint))


def texture_stone(p: Points) -> Surface:
    u, v = p.texture[:, 0] + p.texture[:, 2], p.texture[:, 1] - p.texture[:, 2]
    grain = fractal_noise(u, v, wavelength=0.6, octaves=3, footprint=p.footprint)
    gap = 1 - band((np.mod(u, 0.9) - 0.45), 0.44, p.footprint / np.maximum(p.slant, 0.05))
    return matt(p.color * (1 + 0.2 * grain - 0.3 * gap * (p.footprint < 0.1))[:, None])


def _wall(p: Points, u: Floats, v: Floats) -> Floats:
    """Wall material of a façade without its openings."""
    style = p.params[:, 4]
    weather = fractal_noise(u * 1.8, v * 0.5, wavelength=1.8, octaves=3, footprint=p.footprint)
    grain = fractal_noise(u, v, wavelength=0.15, octaves=2, footprint=p.footprint)
    color = p.color * (1 + 0.16 * weather + 0.08 * grain)[:, None]
    brick, shed = style == 1, style == 3
    color[brick] = _bricks(u[brick], v[brick], p.color[brick], p.footprint[brick])
    rib = np.sin(u[shed] * 2 * np.pi / 0.3) * np.clip(1.2 - p.footprint[shed] / 0.15, 0, 1)
    color[shed] *= (1 + 0.2 * rib)[:, None]
    foot = np.clip(1 - v / 0.5, 0, 1) * (v < 0.55)
    return color * (1 - 0.35 * foot)[:, None]


def texture_facade(p: Points) -> Surface:
    u, v = p.texture[:, 0], p.texture[:, 2]
    wall_id = np.rint(p.texture[:, 1]).astype(np.int64)
    gable = v > 90
    v = np.where(gable, v - 100, v)
    bay, floor, wide, tall, style, front, ground, seed = p.params.T
    key = (seed * 65521).astype(np.int64)
    foot = p.footprint / np.maximum(p.slant, 0.15)
    albedo = _wall(p, u, v)
    glow = np.zeros_like(albedo)

    # There is one window for each bay of each upper floor.
    i, j = np.floor(u / bay), np.floor((v - ground) / floor)
    a = (u / bay - i - 0.5) * bay
    b = ((v - ground) / floor - j - 0.47) * floor
    half_w, half_h = wide * bay / 2, tall * floor / 2
    upper = (v > ground) & ~gable & ((wall_id % 2 == 0) | (hash01(key, 77) < 0.4))
    house_floor = (front != 1) & (v <= ground) & ~gable & (wall_id % 2 == 0)
    exists = upper | house_floor
    frame_color = np.where(hash01(key, 11)[:, None] < 0.7, np.float32(0.62), np.float32(0.07))
    casing = band(a, half_w + 0.12, foot) * band(b - 0.02, half_h + 0.16, p.footprint)
    trimmed = (hash01(key, 12) < 0.55) & (style < 2)
    albedo = mix(albedo, (0.6, 0.58, 0.54), casing * (exists & trimmed) * 0.8)
    sill = band(a, half_w + 0.1, foot) * band(b + half_h + 0.06, 0.06, p.footprint)
    albedo = mix(albedo, (0.5, 0.48, 0.45), sill * (exists & (style < 2)) * 0.9)
    hole = band(a, half_w, foot) * band(b, half_h, p.footprint) * exists
    albedo = mix(albedo, frame_color, hole)
    bars = np.where(hash01(key, 13) < 0.6, 0.04, 0.0)
    pane = band(np.abs(a) - half_w / 2 - bars / 4, half_w / 2 - 0.045 - bars / 4, foot)
    pane *= band(b, half_h - 0.06, p.footprint)
    cross = (hash01(key, 14) < 0.5) & (style < 2)
    pane *= 1 - cross * band(b - half_h * 0.25, 0.03, p.footprint)
    pane *= exists
    lot = hash01(key, i, j)
    curtain = np.where(lot < 0.45, 0.25 + 0.35 * hash01(key, j, i, 2), 0.0)
    blind = band(b - half_h, half_h, p.footprint)
    drawn = (np.abs(a) > half_w * 0.55).astype(np.float32)
    shut = np.where(hash01(key, i, j, 4) < 0.25, blind, drawn)
    dark = 0.012 + 0.05 * hash01(key, i, j, 3)
    inside = np.maximum(dark, curtain * shut)
    # The reveal throws a shadow on the head of the pane.
    inside = inside * (1 - 0.6 * np.clip((b - half_h + 0.22) / 0.1, 0, 1))
    albedo = mix(albedo, np.stack([inside, inside * 1.02, inside * 1.05], 1), pane)
    gloss = (pane * (0.06 + 0.08 * (style == 2))).astype(np.float32)

    shop = (front == 1) & (v <= ground) & ~gable & (wall_id == 0)
    values = (u, v, albedo, ground, key, foot, p.footprint)
    albedo[shop], gloss[shop], glow[shop] = _shop_front(*(value[shop] for value in values))
    door = house_floor & (wall_id == 0) & (np.mod(i, 3) == 1) & (v < 2.5)
    leaf = band(a[door], 0.52, foot[door]) * band(v[door] - 1.1, 1.1, p.footprint[door])
    tone = hash01(key[door], 21)[:, None] * (0.3, 0.12, 0.1) + np.array((0.02, 0.05, 0.05))
    albedo[door] = mix(albedo[door], tone, leaf)
    gloss[door] *= 1 - leaf
    return Surface(albedo.astype(np.float32), gloss, glow.astype(np.float32))


def _shop_front(
    u: Floats, v: Floats, wall: Floats, ground: Floats, key: Floats, wide: Floats, tall: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return albedo, gloss and glow of shops; a pixel covers wide x tall metres of the wall."""
    unit = 5.5
    shop = np.floor(u / unit)
    a = (u / unit - shop - 0.5) * unit
    pick = [hash01(key, shop, k)[:, None] for k in range(31, 35)]
    fascia_color = np.concatenate(pick[:3], 1) ** 2 * 0.6 + 0.02
    fascia = band(a, unit / 2 - 0.15, wide) * band(v - (ground - 0.45), 0.36, tall)
    color = mix(wall, fascia_color, fascia)
    # The lettering is blocks of random width, dark on light or light on dark.
    letter = hash01(key, shop, np.floor(a / 0.24), 9) < 0.75
    stroke = band(np.mod(a, 0.24) - 0.12, 0.085, wide) * band(v - (ground - 0.45), 0.17, tall)
    extent = np.abs(a) < 0.6 + 1.4 * pick[3][:, 0]
    ink = np.where(fascia_color.mean(1, keepdims=True) > 0.2, np.float32(0.03), np.float32(0.65))
    color = mix(color, ink, stroke * letter * extent * 0.9)
    half = (ground - 0.9) / 2
    frame = band(a, unit / 2 - 0.2, wide) * band(v - half - 0.1, half - 0.1, tall)
    color = mix(color, fascia_color * 0.5, frame)
    pane = np.floor(a / 1.7)
    glass = band((a / 1.7 - pane - 0.5) * 1.7, 0.8, wide) * band(v - half - 0.25, half - 0.35, tall)
    goods = fractal_noise(u * 1.3, v * 1.3, wavelength=1.0, octaves=3, footprint=tall)
    tones = np.stack([hash01(np.floor(u / 0.8), k, key) for k in (1, 2, 3)], axis=1)
    wares = np.clip(0.05 + 0.12 * goods, 0.012, 0.3)[:, None] * (0.7 + 0.9 * tones)
    color = mix(color, wares, glass)
    lit = (pick[3] < 0.4) * glass[:, None] * np.clip(0.5 + goods, 0, 1)[:, None]
    return color, glass * 0.07, lit * np.array((0.16, 0.13, 0.08))


def texture_roof(p: Points) -> Surface:
    u, v = p.texture[:, 0], p.texture[:, 1]
    row = np.floor(v / 0.32)
    column = np.floor(u / 0.25 + 0.5 * np.mod(row, 2))
    fade = np.clip(1.2 - p.footprint / 0.25, 0, 1)
    tone = 1 + 0.3 * (hash01(row, column) - 0.5) * fade
    tone -= 0.35 * fade * np.clip(1 - np.mod(v, 0.32) / 0.07, 0, 1)
    tone += 0.2 * fractal_noise(u, v, wavelength=2.5, octaves=3, footprint=p.footprint)
    return matt(p.color * tone[:, None], 0.01)


def texture_planks(p: Points) -> Surface:
    """Texture boards, ribs or awning stripes; the params are pitch, contrast and seed."""
    u = p.texture[:, 0] + p.texture[:, 1]
    pitch, contrast = p.params[:, 0], p.params[:, 1]
    k = np.floor(u / pitch)
    foot = p.footprint / np.maximum(p.slant, 0.1)
    fade = np.clip(1.3 - foot / pitch, 0, 1)
    tone = 1 + contrast * (hash01(k, 3) - 0.5) * fade
    tone *= 1 - 0.4 * fade * (1 - band((u / pitch - k - 0.5) * pitch, 0.45 * pitch, foot))
    z = p.texture[:, 2]
    tone += 0.1 * fractal_noise(u * 3, z, wavelength=0.9, octaves=3, footprint=p.footprint)
    return matt(p.color * tone[:, None], 0.01)
