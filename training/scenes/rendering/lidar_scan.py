"""Simulation of a spinning LiDAR beside the camera: parallax, glass, dark and far surfaces."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.lidar.simulate import HDL64_ELEVATIONS_DEG
from training.scenes.arrays import Floats
from training.scenes.rendering.camera import Camera
from training.scenes.rendering.raycast import RayCaster
from training.scenes.textures.surface import SurfaceKind

# Angles of an HDL-64E at 10 Hz, and their range for other LiDARs [degrees].
_HDL64_AZIMUTH_STEP_DEG, _AZIMUTH_STEPS_DEG = 0.17, (0.1, 0.35)
# Scan lines of other LiDARs, and the ranges of their highest and lowest elevations [degrees].
_LINES, _HIGHEST_DEG, _LOWEST_DEG = (32, 40, 64, 128), (2.0, 15.0), (-30.0, -15.0)
# The axes of a LiDAR (x forward, y left, z up) in those of a camera (x right, y down, z forward).
_LIDAR_TO_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_RANGE_NOISE_M = 0.02
_LONGEST_RANGE_M = 120.0
_MOST_SURFACES = 4  # surfaces that a pulse may meet
# For each kind: the gloss from which its surface is a pane of glass (see the textures of these
# kinds).
_PANES = {
    SurfaceKind.CAR_GLASS: 0.0,
    SurfaceKind.CAR_SIDE_WINDOW: 0.07,
    SurfaceKind.BUS_SIDE: 0.065,
    SurfaceKind.FACADE: 0.03,
}
# Shares of the pulses on a vehicle's pane that pass through it, and that are lost.
_PANE_PASSES, _PANE_LOSES = 0.6, 0.3
# Share of the pulses on a window of a house that is lost; most others return from the room.
_WINDOW_LOSES, _WINDOW_ROOM, _ROOM_M = 0.5, 0.4, 3.0


@dataclass(frozen=True)
class LidarMount:
    """A spinning LiDAR and its pose.

    Attributes:
        to_camera: float64 (4, 4), from its frame [m] to the camera's.
        elevations_deg: elevation of each line, (lines,), from the top.
        azimuth_step_deg: angle between two pulses of a line.
    """

    to_camera: NDArray[np.float64]
    elevations_deg: NDArray[np.float64]
    azimuth_step_deg: float


@dataclass(frozen=True)
class LidarScan:
    """One turn of the LiDAR.

    Attributes:
        points: float32 (N, 4), x, y, z [m] in its own frame and reflectance 0..1. They are in
            KITTI's order, ring after ring from the top, each counter-clockwise from straight ahead.
        to_camera: float64 (4, 4), from that frame to the camera's.
    """

    points: NDArray[np.float32]
    to_camera: NDArray[np.float64]


def draw_mount(camera: Camera, rng: Generator, *, varied: bool = False) -> LidarMount:
    """Return an HDL-64E on the roof, about as in KITTI: behind and above the camera, level.

    With `varied` it is a LiDAR of 32 to 128 lines with random elevations, evenly spaced or denser
    at the horizon, up to 1.5 m behind the camera and 0.6 m beside it.
    """
    tilt = np.deg2rad(rng.normal(0.0, 0.4, 3) - [camera.pitch_deg, 0.0, 0.0])
    to_camera = np.eye(4)
    to_camera[:3, :3] = _rotation(*tilt) @ _LIDAR_TO_CAMERA
    to_camera[:3, 3] = [rng.normal(0.0, 0.08), -rng.uniform(0.03, 0.4), -rng.uniform(0.0, 0.6)]
    if varied:
        to_camera[:3, 3] = [rng.uniform(-0.6, 0.6), -rng.uniform(0.0, 0.8), -rng.uniform(0.0, 1.5)]
    to_camera[1, 3] -= max(0.0, 1.6 - camera.mount_height_m)  # the LiDAR stays on the roof
    elevations, step = HDL64_ELEVATIONS_DEG, _HDL64_AZIMUTH_STEP_DEG
    if varied:
        elevations, step = _draw_elevations(rng), rng.uniform(*_AZIMUTH_STEPS_DEG)
    return LidarMount(to_camera, elevations + rng.normal(0.0, 0.03, len(elevations)), step)


def _draw_elevations(rng: Generator) -> Floats:
    """Return the elevations [degrees] of a random LiDAR, from the top."""
    lines = int(rng.choice(_LINES))
    highest, lowest = rng.uniform(*_HIGHEST_DEG), rng.uniform(*_LOWEST_DEG)
    # An exponent above 1 puts more lines at the horizon.
    exponent = rng.choice([1.0, rng.uniform(1.3, 2.0)])
    even = np.linspace(highest ** (1 / exponent), -((-lowest) ** (1 / exponent)), lines)
    return np.asarray(np.sign(even) * np.abs(even) ** exponent)


def scan_street(
    caster: RayCaster, camera: Camera, rotation: Floats, mount: LidarMount, rng: Generator
) -> LidarScan:
    """Return the returns of one turn that are visible in the image.

    A pulse passes through a vehicle's pane, or is lost at it, more often than it returns; dark,
    slanted and far surfaces lose pulses, too.

    Args:
        caster: its mesh is around the camera at the origin, in world axes.
        camera: the camera.
        rotation: (3, 3), camera to world.
        mount: the LiDAR.
        rng: source of random numbers.
    """
    step, lines = np.deg2rad(mount.azimuth_step_deg), len(mount.elevations_deg)
    wide = np.arctan2(camera.size[1] * 0.75, camera.focal_px)
    half = np.arange(0.0, wide, step)
    azimuth = np.concatenate([half, half[1:][::-1] * -1.0])
    ring = np.repeat(np.arange(lines), len(azimuth))
    turn = np.tile(azimuth, lines) + step * rng.random(lines)[ring]
    rise = np.deg2rad(mount.elevations_deg)[ring]
    flat = np.cos(rise)
    local = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(rise)], axis=1)
    to_world = (rotation @ mount.to_camera[:3, :3]).T
    directions = (local @ to_world).astype(np.float32)
    start = (rotation @ mount.to_camera[:3, 3]).astype(np.float32)
    distance, reflectance = _ranges(caster, start, directions, rng)
    kept = np.isfinite(distance)
    points = local[kept] * (distance[kept] + rng.normal(0, _RANGE_NOISE_M, kept.sum()))[:, None]
    x, y, z = (points @ mount.to_camera[:3, :3].T + mount.to_camera[:3, 3]).T
    depth = np.where(z > 0.1, z, np.nan)
    column = np.rint(camera.cx + camera.focal_px * x / depth)
    row = np.rint(camera.cy + camera.focal_px * y / depth)
    height, width = camera.size
    seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    found = np.column_stack([points[seen], reflectance[kept][seen]]).astype(np.float32)
    return LidarScan(found, mount.to_camera)


def _ranges(
    caster: RayCaster, start: Floats, directions: Floats, rng: Generator
) -> tuple[Floats, Floats]:
    """Return the range [m], (n,), NaN without a return, and the reflectance 0..1 of each pulse."""
    count = len(directions)
    distance, under_way = np.full(count, np.nan, dtype=np.float32), np.arange(count)
    reflectance, travelled = np.zeros((2, count), dtype=np.float32)
    for _ in range(_MOST_SURFACES):
        origins = start + directions[under_way] * travelled[under_way, None]
        hits = caster.first_hit(origins, directions[under_way])
        met = (hits.face >= 0) & (hits.distance + travelled[under_way] < _LONGEST_RANGE_M)
        under_way = under_way[met]
        if not len(under_way):
            break
        hits = hits.take(met)
        travelled[under_way] += hits.distance
        length = travelled[under_way]
        footprint = length * np.float32(2e-3)
        points, surface = caster.surfaces(hits, directions[under_way], footprint)
        kind = caster.mesh.kind[hits.face]
        pane = np.zeros(len(kind), dtype=bool)
        for glassy, gloss in _PANES.items():
            pane |= (kind == glassy) & (surface.gloss > gloss)
        window = pane & (kind == SurfaceKind.FACADE)
        lot = rng.random(len(kind))
        passes = pane & ~window & (lot < _PANE_PASSES)
        lost = pane & ~window & ~passes & (lot < _PANE_PASSES + _PANE_LOSES)
        lost |= window & (lot < _WINDOW_LOSES)
        deeper = window & ~lost & (lot < _WINDOW_LOSES + _WINDOW_ROOM)
        length = length + np.where(deeper, _ROOM_M * rng.random(len(kind)), 0.0)

        bright = surface.albedo.mean(axis=1).clip(0.02, 1.0)
        # A 10 % reflective surface is seen to about 50 m, a bright one to 120 m (data sheet).
        reach = _LONGEST_RANGE_M * (bright / 0.8) ** 0.4 * points.slant.clip(0.02, 1.0) ** 0.15
        fades = 0.03 + 0.9 * np.clip(length / reach, 0, 1) ** 4
        lost |= ~passes & (rng.random(len(kind)) < fades)
        back = under_way[~passes & ~lost]
        distance[back] = length[~passes & ~lost]
        reflectance[back] = bright[~passes & ~lost]
        under_way = under_way[passes]
        travelled[under_way] += np.float32(0.01)  # behind the pane
    return distance, reflectance


def _rotation(pitch: float, yaw: float, roll: float) -> NDArray[np.float64]:
    """Return the rotation about the camera's x, y and z axes [rad]."""
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (pitch, yaw, roll))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)
