"""Procedural textures: albedo, gloss and glow of every surface kind, anchored to the surface."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.scenes.arrays import Floats
from training.scenes.noise import fractal_noise, hash01, value_noise
from training.scenes.paint import Stripe, band, paint_cover
from training.scenes.surface_kinds import SurfaceKind


@dataclass(frozen=True)
class Points:
    """Surface points to texture; n rows each.

    texture: (n, 3) the object's own coordinates [m]. normal: (n, 3). color: (n, 3) base colour.
    params: (n, 8). footprint: (n,) metres a pixel covers across the view ray; slant: (n,) cosine
    between view ray and normal, 0..1.
    """

    texture: Floats
    normal: Floats
    color: Floats
    params: Floats
    footprint: Floats
    slant: Floats

    def take(self, rows: NDArray[np.intp]) -> "Points":
        """Some of the points."""
        return Points(
            self.texture[rows],
            self.normal[rows],
            self.color[rows],
            self.params[rows],
            self.footprint[rows],
            self.slant[rows],
        )


@dataclass(frozen=True)
class Surface:
    """What the shader needs: albedo (n, 3) linear, gloss (n,) mirror share at normal incidence,
    glow (n, 3) light of its own."""

    albedo: Floats
    gloss: Floats
    glow: Floats


def _plain(albedo: Floats, gloss: float | Floats = 0.0) -> Surface:
    shiny = np.broadcast_to(np.float32(gloss), (len(albedo),)).astype(np.float32)
    return Surface(albedo, shiny, np.zeros_like(albedo))


def _mix(a: Floats, b: Floats | Sequence[float], weight: Floats) -> Floats:
    w = weight[:, None]
    return a * (1 - w) + np.asarray(b, dtype=np.float32) * w


def _asphalt(p: Points, stripes: Sequence[Stripe]) -> Surface:
    s, d = p.texture[:, 0], p.texture[:, 1]
    # The camera looks along the road: footprints stretch along s, hardly along d.
    long = p.footprint / np.maximum(p.slant, 0.02)
    grain = fractal_noise(s, d, wavelength=0.16, octaves=4, footprint=np.sqrt(long * p.footprint))
    stain = fractal_noise(s * 0.35, d, wavelength=1.9, octaves=3, footprint=p.footprint)
    worn = fractal_noise(s * 0.08, d, wavelength=1.1, octaves=2, footprint=p.footprint)
    tone = 1 + 0.36 * grain + 0.1 * stain + 0.09 * worn
    cell_s, cell_d = np.floor(s / 9.0).astype(np.int64), np.floor(d / 2.9).astype(np.int64)
    chance = hash01(cell_s, cell_d, 7)
    in_s, in_d = s / 9.0 - cell_s - 0.5, d / 2.9 - cell_d - 0.5
    size = 0.12 + 0.3 * hash01(cell_s, cell_d, 8)
    patch = band(in_s, size, long / 9.0) * band(in_d, size * 0.8, p.footprint / 2.9)
    tone *= 1 - np.where(chance < 0.07, 0.22, 0.0) * patch
    hole = np.hypot(in_s * 9.0, in_d * 2.9) - 0.33
    tone *= 1 - 0.55 * (chance > 0.94) * np.clip(0.5 - hole / np.maximum(long, 0.02), 0, 1)
    crack = np.abs(value_noise(s * 0.45, d * 0.9)) + 0.3 * np.abs(value_noise(s * 3, d * 3))
    tone *= 1 - 0.4 * np.clip(1 - crack / 0.05, 0, 1) * np.clip(1 - long / 0.2, 0, 1)
    albedo = p.color * np.clip(tone, 0.3, 1.8)[:, None]
    bare = np.clip(0.85 + 0.5 * stain + 0.25 * grain, 0.35, 0.95)
    for stripe in stripes:
        near = (
            (s > stripe.start - 6) & (s < stripe.end + 6)
            if stripe.along == "s"
            else np.abs(s - stripe.centre) < stripe.half_width + 6
        )
        rows = np.flatnonzero(near)
        if len(rows):
            cover = paint_cover(stripe, s[rows], d[rows], long[rows], p.footprint[rows])
            albedo[rows] = _mix(albedo[rows], stripe.color, cover * bare[rows])
    return _plain(albedo)


def _paving(p: Points, _: Sequence[Stripe]) -> Surface:
    s, d = p.texture[:, 0], p.texture[:, 1]
    pitch = p.params[:, 0]
    long = p.footprint / np.maximum(p.slant, 0.02)
    i, j = np.floor(s / pitch), np.floor(d / pitch)
    slab = hash01(i.astype(np.int64), j.astype(np.int64), 3) - 0.5
    fade = np.clip(1.2 - long / pitch, 0, 1)
    tone = 1 + 0.22 * slab * fade
    grain = fractal_noise(s, d, wavelength=0.5, octaves=4, footprint=np.sqrt(long * p.footprint))
    tone += 0.16 * grain + 0.12 * fractal_noise(s, d, wavelength=3.0, octaves=2)
    joint = 1 - band((s / pitch - i - 0.5) * pitch, 0.485 * pitch, long) * band(
        (d / pitch - j - 0.5) * pitch, 0.485 * pitch, p.footprint
    )
    tone *= 1 - 0.4 * joint * fade
    return _plain(p.color * np.clip(tone, 0.3, 1.7)[:, None])


def _grass(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y = p.texture[:, 0], p.texture[:, 1]
    blades = fractal_noise(x, y, wavelength=0.35, octaves=4, footprint=p.footprint * 2)
    meadow = fractal_noise(x, y, wavelength=6.0, octaves=3, footprint=p.footprint)
    dry = np.clip(0.35 + 0.9 * meadow + 0.3 * (p.params[:, 0] - 0.5), 0, 1)
    color = _mix(p.color, (0.19, 0.17, 0.075), dry)
    return _plain(color * np.clip(1 + 0.55 * blades, 0.3, 1.8)[:, None])


def _bricks(
    u: Floats,
    v: Floats,
    color: Floats,
    footprint: Floats,
    *,
    tall: float = 0.075,
    wide: float = 0.225,
) -> Floats:
    row = np.floor(v / tall)
    shifted = u / wide + 0.5 * np.mod(row, 2)
    column = np.floor(shifted)
    fade = np.clip(1.3 - footprint / tall, 0, 1)
    tone = 1 + 0.5 * (hash01(row.astype(np.int64), column.astype(np.int64), 5) - 0.5) * fade
    mortar = 1 - band((v / tall - row - 0.5) * tall, tall * 0.43, footprint) * band(
        (shifted - column - 0.5) * wide, wide * 0.47, footprint
    )
    tone += 0.12 * fractal_noise(u, v, wavelength=2.5, octaves=2)
    return _mix(color * tone[:, None], (0.38, 0.35, 0.31), mortar * fade * 0.7)


def _brickwork(p: Points, _: Sequence[Stripe]) -> Surface:
    u = p.texture[:, 0] + p.texture[:, 1]
    return _plain(_bricks(u, p.texture[:, 2], p.color, p.footprint))


def _stone(p: Points, _: Sequence[Stripe]) -> Surface:
    u, v = p.texture[:, 0] + p.texture[:, 2], p.texture[:, 1] - p.texture[:, 2]
    grain = fractal_noise(u, v, wavelength=0.6, octaves=3, footprint=p.footprint)
    gap = 1 - band((np.mod(u, 0.9) - 0.45), 0.44, p.footprint / np.maximum(p.slant, 0.05))
    return _plain(p.color * (1 + 0.2 * grain - 0.3 * gap * (p.footprint < 0.1))[:, None])


def _wall(p: Points, u: Floats, v: Floats) -> Floats:
    """Wall material of a façade without its openings."""
    style = p.params[:, 4]
    weather = fractal_noise(u * 1.8, v * 0.5, wavelength=1.8, octaves=3, footprint=p.footprint)
    grain = fractal_noise(u, v, wavelength=0.15, octaves=2, footprint=p.footprint)
    color = p.color * (1 + 0.16 * weather + 0.08 * grain)[:, None]
    brick = np.flatnonzero(style == 1)
    if len(brick):
        color[brick] = _bricks(u[brick], v[brick], p.color[brick], p.footprint[brick])
    shed = np.flatnonzero(style == 3)
    if len(shed):
        rib = np.sin(u[shed] * 2 * np.pi / 0.3) * np.clip(1.2 - p.footprint[shed] / 0.15, 0, 1)
        color[shed] *= (1 + 0.2 * rib)[:, None]
    foot = np.clip(1 - v / 0.5, 0, 1) * (v < 0.55)
    return color * (1 - 0.35 * foot)[:, None]


def _facade(p: Points, _: Sequence[Stripe]) -> Surface:
    u, v = p.texture[:, 0], p.texture[:, 2]
    wall_id = np.rint(p.texture[:, 1]).astype(np.int64)
    gable = v > 90
    v = np.where(gable, v - 100, v)
    bay, floor, wide, tall, style, front, ground, seed = p.params.T
    key = (seed * 65521).astype(np.int64)
    foot = p.footprint / np.maximum(p.slant, 0.15)
    albedo = _wall(p, u, v)
    gloss = np.zeros(len(u), dtype=np.float32)
    glow = np.zeros_like(albedo)

    # Windows of the upper floors, one a bay and floor.
    i, j = np.floor(u / bay), np.floor((v - ground) / floor)
    i_key, j_key = i.astype(np.int64), j.astype(np.int64)
    a = (u / bay - i - 0.5) * bay
    b = ((v - ground) / floor - j - 0.47) * floor
    half_w, half_h = wide * bay / 2, tall * floor / 2
    upper = (v > ground) & ~gable & ((wall_id % 2 == 0) | (hash01(key, 77) < 0.4))
    house_floor = (front != 1) & (v <= ground) & ~gable & (wall_id % 2 == 0)
    exists = upper | house_floor
    frame_color = np.where(hash01(key, 11)[:, None] < 0.7, np.float32(0.62), np.float32(0.07))
    casing = band(a, half_w + 0.12, foot) * band(b - 0.02, half_h + 0.16, p.footprint)
    trimmed = (hash01(key, 12) < 0.55) & (style < 2)
    albedo = _mix(albedo, (0.6, 0.58, 0.54), casing * (exists & trimmed) * 0.8)
    sill = band(a, half_w + 0.1, foot) * band(b + half_h + 0.06, 0.06, p.footprint)
    albedo = _mix(albedo, (0.5, 0.48, 0.45), sill * (exists & (style < 2)) * 0.9)
    hole = band(a, half_w, foot) * band(b, half_h, p.footprint) * exists
    albedo = _mix(albedo, frame_color, hole)
    bars = np.where(hash01(key, 13) < 0.6, 0.04, 0.0)
    pane = band(np.abs(a) - half_w / 2 - bars / 4, half_w / 2 - 0.045 - bars / 4, foot) * band(
        b, half_h - 0.06, p.footprint
    )
    cross = (hash01(key, 14) < 0.5) & (style < 2)
    pane *= 1 - cross * band(b - half_h * 0.25, 0.03, p.footprint)
    pane *= exists
    lot = hash01(key, i_key, j_key)
    curtain = np.where(lot < 0.45, 0.25 + 0.35 * hash01(key, j_key, i_key, 2), 0.0)
    shut = np.where(
        hash01(key, i_key, j_key, 4) < 0.25,
        band(b - half_h, half_h, p.footprint),
        (np.abs(a) > half_w * 0.55).astype(np.float32),
    )
    dark = 0.012 + 0.05 * hash01(key, i_key, j_key, 3)
    inside = np.maximum(dark, curtain * shut)
    # The reveal throws a shadow on the head of the pane.
    inside = inside * (1 - 0.6 * np.clip((b - half_h + 0.22) / 0.1, 0, 1))
    albedo = _mix(albedo, np.stack([inside, inside * 1.02, inside * 1.05], 1), pane)
    gloss += pane * (0.06 + 0.08 * (style == 2))

    shop = np.flatnonzero((front == 1) & (v <= ground) & ~gable & (wall_id == 0))
    if len(shop):
        albedo[shop], gloss[shop], glow[shop] = _shop_front(
            u[shop], v[shop], albedo[shop], ground[shop], key[shop], foot[shop], p.footprint[shop]
        )
    door = np.flatnonzero(house_floor & (wall_id == 0) & (np.mod(i_key, 3) == 1) & (v < 2.5))
    if len(door):
        leaf = band(a[door], 0.52, foot[door]) * band(v[door] - 1.1, 1.1, p.footprint[door])
        tone = hash01(key[door], 21)[:, None] * (0.3, 0.12, 0.1) + np.array((0.02, 0.05, 0.05))
        albedo[door] = _mix(albedo[door], tone, leaf)
        gloss[door] *= 1 - leaf
    return Surface(albedo.astype(np.float32), gloss, glow.astype(np.float32))


def _shop_front(
    u: Floats,
    v: Floats,
    wall: Floats,
    ground: Floats,
    key: NDArray[np.int64],
    foot: Floats,
    footprint: Floats,
) -> tuple[Floats, Floats, Floats]:
    unit = 5.5
    shop = np.floor(u / unit)
    shop_key = shop.astype(np.int64)
    a = (u / unit - shop - 0.5) * unit
    pick = [hash01(key, shop_key, k)[:, None] for k in range(31, 35)]
    fascia_color = np.concatenate(pick[:3], 1) ** 2 * 0.6 + 0.02
    fascia = band(a, unit / 2 - 0.15, foot) * band(v - (ground - 0.45), 0.36, footprint)
    color = _mix(wall, fascia_color, fascia)
    # Lettering: blocks of random width, dark on light or light on dark.
    letter = hash01(key, shop_key, np.floor(a / 0.24).astype(np.int64), 9) < 0.75
    stroke = band(np.mod(a, 0.24) - 0.12, 0.085, foot) * band(v - (ground - 0.45), 0.17, footprint)
    extent = np.abs(a) < 0.6 + 1.4 * pick[3][:, 0]
    ink = np.where(fascia_color.mean(1, keepdims=True) > 0.2, np.float32(0.03), np.float32(0.65))
    color = _mix(color, ink, stroke * letter * extent * 0.9)
    frame = band(a, unit / 2 - 0.2, foot) * band(
        v - (ground - 0.9) / 2 - 0.1, (ground - 0.9) / 2 - 0.1, footprint
    )
    color = _mix(color, fascia_color * 0.5, frame)
    pane = np.floor(a / 1.7)
    glass = band((a / 1.7 - pane - 0.5) * 1.7, 0.8, foot) * band(
        v - (ground - 0.9) / 2 - 0.25, (ground - 0.9) / 2 - 0.35, footprint
    )
    goods = fractal_noise(u * 1.3, v * 1.3, wavelength=1.0, octaves=3, footprint=footprint)
    wares = np.clip(0.05 + 0.12 * goods, 0.012, 0.3)[:, None] * (
        0.7
        + 0.9
        * np.concatenate(
            [hash01(np.floor(u / 0.8).astype(np.int64), k, key)[:, None] for k in (1, 2, 3)], 1
        )
    )
    color = _mix(color, wares, glass)
    lit = (pick[3] < 0.4) * glass[:, None] * np.clip(0.5 + goods, 0, 1)[:, None]
    return color, glass * 0.07, lit * np.array((0.16, 0.13, 0.08))


def _roof(p: Points, _: Sequence[Stripe]) -> Surface:
    u, v = p.texture[:, 0], p.texture[:, 1]
    row = np.floor(v / 0.32)
    column = np.floor(u / 0.25 + 0.5 * np.mod(row, 2))
    fade = np.clip(1.2 - p.footprint / 0.25, 0, 1)
    tone = 1 + 0.3 * (hash01(row.astype(np.int64), column.astype(np.int64)) - 0.5) * fade
    tone -= 0.35 * fade * np.clip(1 - np.mod(v, 0.32) / 0.07, 0, 1)
    tone += 0.2 * fractal_noise(u, v, wavelength=2.5, octaves=3, footprint=p.footprint)
    return _plain(p.color * tone[:, None], 0.01)


def _foliage(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    leaf = fractal_noise(x + 0.6 * z, y - 0.7 * z, wavelength=0.5, octaves=3, footprint=p.footprint)
    warm = value_noise(x * 0.8 + z, y * 0.8)
    color = p.color * np.clip(1 + 0.6 * leaf, 0.3, 2.0)[:, None]
    return _plain(color * (1 + warm[:, None] * np.array((0.18, 0.06, -0.05), np.float32)), 0.004)


def _bark(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    ridge = fractal_noise((x + y) * 6, z, wavelength=0.5, octaves=3, footprint=p.footprint)
    return _plain(p.color * (1 + 0.45 * ridge)[:, None])


def _metal(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    dirt = fractal_noise(x + y, z, wavelength=0.7, octaves=2, footprint=p.footprint)
    return _plain(p.color * (1 + 0.15 * dirt)[:, None], 0.05)


def _cloth(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    fold = fractal_noise(x + 2 * y, z * 0.7, wavelength=0.22, octaves=2, footprint=p.footprint)
    return _plain(p.color * (1 + 0.35 * fold)[:, None])


def _paint_or_plain(p: Points, _: Sequence[Stripe]) -> Surface:
    return _plain(p.color.copy(), 0.01)


def _planks(p: Points, _: Sequence[Stripe]) -> Surface:
    """Boards, ribs or awning stripes: params are pitch, contrast, seed."""
    u = p.texture[:, 0] + p.texture[:, 1]
    pitch, contrast = p.params[:, 0], p.params[:, 1]
    k = np.floor(u / pitch)
    foot = p.footprint / np.maximum(p.slant, 0.1)
    fade = np.clip(1.3 - foot / pitch, 0, 1)
    tone = 1 + contrast * (hash01(k.astype(np.int64), 3) - 0.5) * fade
    tone *= 1 - 0.4 * fade * (1 - band((u / pitch - k - 0.5) * pitch, 0.45 * pitch, foot))
    tone += 0.1 * fractal_noise(
        u * 3, p.texture[:, 2], wavelength=0.9, octaves=3, footprint=p.footprint
    )
    return _plain(p.color * tone[:, None], 0.01)


def _car_body(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    rear_x, front_x, radius, length, width, belt, door_x, seed = p.params.T
    f = p.footprint
    albedo, gloss = p.color.copy(), np.full(len(x), 0.05, dtype=np.float32)
    glow = np.zeros_like(albedo)
    half = width / 2
    on_side = np.abs(y) > half * 0.72
    black = np.zeros(len(x), dtype=np.float32)
    for wheel_x in (rear_x, front_x):
        reach = np.hypot(x - wheel_x, z - radius)
        black = np.maximum(black, band(reach, radius + 0.07, f) * on_side)
    black = np.maximum(black, band(z, 0.33, f))  # sills and skirts
    for line_x in (door_x, rear_x + radius + 0.25, (door_x + front_x - radius - 0.1) / 2 + 0.42):
        black = np.maximum(black, 0.7 * band(x - line_x, 0.012, f) * on_side * (z < belt + 0.02))
    handle = band(np.mod(x - door_x, 1.05) - 0.2, 0.09, f) * band(z - belt + 0.12, 0.02, f)
    black = np.maximum(black, 0.6 * handle * on_side * (np.abs(x) < length * 0.25))
    nose, tail = x > length / 2 - 0.22, x < -length / 2 + 0.2
    grille = nose * band(np.abs(y), half * 0.55, f) * band(z - 0.48, 0.13, f)
    black = np.maximum(black, grille * 0.9)
    black = np.maximum(black, (nose | tail) * band(z - 0.36, 0.06, f) * (seed < 0.6))
    # The lid of the boot and the bonnet end in a thin dark gap.
    black = np.maximum(black, 0.6 * tail * band(np.abs(y) - half * 0.62, 0.01, f) * (z > 0.55))
    albedo = _mix(albedo, (0.015, 0.015, 0.016), black)
    gloss *= 1 - 0.8 * black
    lamp_low = np.where(seed < 0.5, 0.58, 0.62)
    head = nose * band(np.abs(y) - half * 0.74, half * 0.2, f) * band(z - lamp_low - 0.07, 0.075, f)
    albedo = _mix(albedo, (0.7, 0.7, 0.68), head)
    glow += (head * np.where(np.mod(seed * 7, 1) < 0.35, 0.9, 0.0))[:, None]
    rear_z = belt - 0.14
    back = tail * band(np.abs(y) - half * 0.82, half * 0.13, f) * band(z - rear_z, 0.1, f)
    albedo = _mix(albedo, (0.42, 0.015, 0.012), back)
    glow += (back * np.where(np.mod(seed * 13, 1) < 0.4, 1.2, 0.08))[:, None] * np.array(
        (1, 0.05, 0.03), np.float32
    )
    middle = (x > length / 2 - 0.12) | (x < -length / 2 + 0.12)
    plate = middle * band(y, 0.26, f) * band(z - np.where(tail, 0.62, 0.42), 0.06, f)
    plate_color = np.where((tail & (seed < 0.4))[:, None], (0.7, 0.5, 0.05), (0.72, 0.72, 0.7))
    albedo = _mix(albedo, plate_color, plate)
    ink = (
        plate
        * (hash01(np.floor(y / 0.06).astype(np.int64), 5) < 0.7)
        * band(np.mod(y, 0.06) - 0.03, 0.02, f)
    )
    albedo = _mix(albedo, (0.03, 0.03, 0.03), ink * 0.9)
    return Surface(albedo.astype(np.float32), gloss.astype(np.float32), glow.astype(np.float32))


def _car_side_window(p: Points, _: Sequence[Stripe]) -> Surface:
    """Side of the greenhouse; texture is (x, cabin height, 0 belt .. 1 roof edge)."""
    x, cabin, q = p.texture.T
    f = p.footprint
    tall = np.maximum(cabin, 0.05)
    pane = band((q - 0.5) * tall, 0.41 * tall - 0.02, f) * (cabin > 0.12)
    for k in (0, 1):
        pane *= 1 - band(x - p.params[:, k], 0.045, f)
    pane *= np.where(p.params[:, 3] != 0, (x > p.params[:, 3]).astype(np.float32), 1.0)
    albedo = _mix(p.color.copy(), (0.016, 0.018, 0.02), pane)
    return _plain(albedo.astype(np.float32), (0.05 + 0.04 * pane).astype(np.float32))


def _car_glass(p: Points, _: Sequence[Stripe]) -> Surface:
    return _plain(p.color.copy(), 0.09)


def _wheel(p: Points, _: Sequence[Stripe]) -> Surface:
    x, z = p.texture[:, 0], p.texture[:, 2]
    radius = p.params[:, 0]
    reach = np.hypot(x, z)
    spokes = 0.5 + 0.5 * np.cos(np.arctan2(z, x) * np.where(p.params[:, 1] < 0.5, 5, 7))
    open_ = np.clip(1.4 - spokes * 1.6, 0, 1) * (reach > 0.18 * radius) * (reach < 0.6 * radius)
    rim = band(reach, 0.66 * radius, p.footprint) * (1 - 0.85 * open_)
    albedo = _mix(np.full_like(p.color, 0.018), p.color, rim)
    return _plain(albedo, (0.04 * rim).astype(np.float32))


def _sign(p: Points, _: Sequence[Stripe]) -> Surface:
    """Faces of traffic signs; texture is the face, -1..1 both ways."""
    a, b = p.texture[:, 0], p.texture[:, 1]
    kind = np.rint(p.params[:, 0]).astype(int)
    reach = np.hypot(a, b)
    f = p.footprint / 0.38
    white, red = (0.75, 0.75, 0.73), (0.55, 0.02, 0.02)
    blue, yellow, green = (0.02, 0.1, 0.42), (0.75, 0.5, 0.02), (0.01, 0.2, 0.1)
    black = (0.02, 0.02, 0.02)
    out = np.tile(np.asarray(white, dtype=np.float32), (len(a), 1))

    def lay(which: NDArray[np.bool_], cover: Floats, color: Sequence[float]) -> None:
        rows = np.flatnonzero(which)
        out[rows] = _mix(out[rows], color, cover[rows])

    ones = np.ones_like(a)
    glyph = band(np.abs(a) - 0.2, 0.12, f) * band(b, 0.32, f)
    bar = band(a, 0.11, f) * band(b - 0.02, 0.38, f)
    lay(kind == 0, 1 - band(reach, 0.72, f), red)
    lay(kind == 0, glyph, black)
    low = (b + 0.8) / 1.75  # 0 at the base of a triangle, 1 at its tip
    rim = np.minimum(low - 0.12, (1 - low) * 0.9 - np.abs(a) - 0.22) / np.maximum(f, 0.02)
    lay(kind == 1, 1 - np.clip(rim + 0.5, 0, 1), red)
    lay(kind == 1, band(a, 0.08, f) * band(b + 0.15, 0.3, f), black)
    high = (0.95 - (b + 0.15)) / 1.75
    inner = np.minimum(high - 0.12, (1 - high) * 0.9 - np.abs(a) - 0.22) / np.maximum(f, 0.02)
    lay(kind == 7, 1 - np.clip(inner + 0.5, 0, 1), red)
    lay(kind == 2, ones, blue)
    lay(kind == 2, bar + band(np.abs(a) - (0.5 - b) * 0.8, 0.1, f) * (b > 0.05) * (b < 0.5), white)
    lay(kind == 3, ones, red)
    lay(kind == 3, band(a, 0.68, f) * band(b, 0.17, f), white)
    lay(kind == 4, band(np.abs(a) + np.abs(b), 0.72, f), yellow)
    board = np.where(
        (p.params[:, 1] < 0.4)[:, None],
        blue,
        np.where((p.params[:, 1] < 0.7)[:, None], green, yellow),
    ).astype(np.float32)
    rows = np.flatnonzero(kind == 5)
    edge = band(a, 0.96, f) * band(b, 0.93, f)
    out[rows] = _mix(out[rows], board[rows], edge[rows])
    line = np.floor((b + 1) * 2.2)
    word = hash01(np.floor(a * 9).astype(np.int64), line.astype(np.int64), 6) < 0.7
    text = (
        band(np.mod((b + 1) * 2.2, 1) - 0.5, 0.24, f * 2.2)
        * band(np.mod(a * 9, 1) - 0.5, 0.34, f * 9)
        * word
        * (np.abs(a) < 0.8)
    )
    lay((kind == 5) & (p.params[:, 1] < 0.7), text * 0.9, white)
    lay((kind == 5) & (p.params[:, 1] >= 0.7), text * 0.9, black)
    lay(kind == 6, band(a, 0.92, f) * band(b, 0.92, f), blue)
    lay(kind == 6, bar + band(a - 0.15, 0.22, f) * band(b - 0.2, 0.2, f), white)
    lay(kind == 9, (1 - band(a, 0.93, f) * band(b, 0.85, f)) + text, black)
    return _plain(out, 0.03)


def _glow(p: Points, _: Sequence[Stripe]) -> Surface:
    return Surface(
        p.color.copy(),
        np.full(len(p.color), 0.04, np.float32),
        (p.color * p.params[:, :1]).astype(np.float32),
    )


def _bus_side(p: Points, _: Sequence[Stripe]) -> Surface:
    x, y, z = p.texture.T
    height, length, width = p.params[:, 0], p.params[:, 1], p.params[:, 2]
    f = p.footprint / np.maximum(p.slant, 0.2)
    on_end = np.abs(x) > length / 2 - 0.02
    run, half_run = np.where(on_end, y, x), np.where(on_end, width / 2, length / 2)
    glass = band(z - 1.85, 0.55, f) * band(run, half_run - 0.18, f)
    upper = band(z - 3.3, 0.42, f) * band(run, half_run - 0.18, f) * (height > 3.5)
    pane = np.maximum(glass, upper) * np.where(on_end, 1.0, band(np.mod(x, 1.5) - 0.75, 0.7, f))
    albedo = p.color * np.where(z < 0.8, 0.85, 1.0)[:, None]
    stripe = band(z - 1.05, 0.12, f)
    albedo = _mix(albedo, (0.6, 0.6, 0.58), stripe * 0.8)
    albedo = _mix(albedo, (0.015, 0.017, 0.02), pane)
    skirt = band(z, 0.42, f)
    albedo = _mix(albedo, (0.02, 0.02, 0.02), skirt)
    return _plain(albedo.astype(np.float32), (0.04 + 0.05 * pane).astype(np.float32))


_SHADERS: dict[SurfaceKind, Callable[[Points, Sequence[Stripe]], Surface]] = {
    SurfaceKind.PLAIN: _paint_or_plain,
    SurfaceKind.ASPHALT: _asphalt,
    SurfaceKind.PAVING: _paving,
    SurfaceKind.GRASS: _grass,
    SurfaceKind.FACADE: _facade,
    SurfaceKind.ROOF: _roof,
    SurfaceKind.FOLIAGE: _foliage,
    SurfaceKind.BARK: _bark,
    SurfaceKind.METAL: _metal,
    SurfaceKind.CAR_BODY: _car_body,
    SurfaceKind.CAR_SIDE_WINDOW: _car_side_window,
    SurfaceKind.CAR_GLASS: _car_glass,
    SurfaceKind.WHEEL: _wheel,
    SurfaceKind.SIGN: _sign,
    SurfaceKind.GLOW: _glow,
    SurfaceKind.BRICKWORK: _brickwork,
    SurfaceKind.PLANKS: _planks,
    SurfaceKind.CLOTH: _cloth,
    SurfaceKind.BUS_SIDE: _bus_side,
    SurfaceKind.STONE: _stone,
}


def texture_surfaces(kind: NDArray[np.uint8], points: Points, stripes: Sequence[Stripe]) -> Surface:
    """Surface of every point by its kind, (n,) uint8 of `SurfaceKind`."""
    n = len(kind)
    albedo = np.zeros((n, 3), dtype=np.float32)
    gloss = np.zeros(n, dtype=np.float32)
    glow = np.zeros((n, 3), dtype=np.float32)
    for value in np.unique(kind):
        rows = np.flatnonzero(kind == value)
        part = _SHADERS[SurfaceKind(value)](points.take(rows), stripes)
        albedo[rows], gloss[rows], glow[rows] = part.albedo, part.gloss, part.glow
    return Surface(np.clip(albedo, 0.005, 0.95), gloss, glow)
