"""One frame of a street: RGB, depth and classes of the same rays."""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.scenes.arrays import Floats
from training.scenes.layout.street import Street
from training.scenes.names import SceneClass
from training.scenes.rendering.camera import Camera, look_along
from training.scenes.rendering.lidar_scan import LidarMount, LidarScan, scan_street
from training.scenes.rendering.raycast import Hits, RayCaster
from training.scenes.rendering.shading import contact_shading, shade
from training.scenes.rendering.weather import Weather
from training.scenes.things.mesh import join

MAX_DEPTH_M = 655.0
_SHADOW_MARGIN_M = 25.0
_JITTER = ((-0.3, -0.3), (0.3, -0.1), (-0.1, 0.3))


@dataclass(frozen=True)
class RenderedFrame:
    """A rendered frame.

    Attributes:
        rgb: uint8 (H, W, 3).
        depth: float32 (H, W), metres along the optical axis, 0 = sky.
        label: uint8 (H, W) of `SceneClass`.
        world_to_camera: (4, 4).
        intrinsics: (3, 3).
        scan: scan of its LiDAR.
    """

    rgb: NDArray[np.uint8]
    depth: Floats
    label: NDArray[np.uint8]
    world_to_camera: Floats
    intrinsics: Floats
    scan: LidarScan


def camera_pose(
    street: Street, camera: Camera, time: float, *, sway: float
) -> tuple[Floats, Floats]:
    """Return rotation (camera to world) and position of the ego camera at a time in seconds.

    `sway`, 0 to 1000, is a phase that makes pitch, yaw and roll differ between scenes.
    """
    s = street.ego_speed * time
    d = street.ego_d + 0.12 * np.sin(0.7 * time + sway)
    position = street.line.at(s, d, camera.mount_height_m)
    ahead = street.line.at(s + 1.0, d, camera.mount_height_m) - position
    pitch = np.arctan2(ahead[2], 1.0) + np.deg2rad(
        camera.pitch_deg + 0.25 * np.sin(5.1 * time + sway) + 0.5 * np.sin(sway * 1.7)
    )
    yaw = np.deg2rad(0.6 * np.sin(1.3 * time + 2 * sway) + 1.2 * np.sin(sway * 2.9))
    roll = np.deg2rad(0.3 * np.sin(2.3 * time + 3 * sway) + 0.4 * np.sin(sway))
    return look_along(float(street.line.heading_at(s)) + yaw, float(pitch), float(roll)), position


def render_frame(
    street: Street,
    camera: Camera,
    weather: Weather,
    mount: LidarMount,
    *,
    time: float,
    sway: float,
    rng: Generator,
) -> RenderedFrame:
    """Render the street at a time in seconds, as the ego car's camera and LiDAR see it.

    RGB, depth and classes do not depend on the LiDAR.
    """
    lidar_rng = rng.spawn(1)[0]
    rotation, position = camera_pose(street, camera, time, sway=sway)
    ego_s = street.ego_speed * time
    present = [a for a in street.actors if -25 < a.s + a.speed * time - ego_s < 220]
    # Triangles far behind the camera are dropped; a margin keeps shadows.
    corners = street.standing.positions - position.astype(np.float32)
    reach = (corners @ rotation[:, 2].astype(np.float32)).max(axis=1)
    ahead = street.standing.take(reach > -_SHADOW_MARGIN_M)
    # Rays start at the origin, where float32 is most precise.
    mesh = join(
        ahead.moved(offset=-position),
        *(a.at(time, street.line).moved(offset=-position) for a in present),
    )
    caster = RayCaster(mesh, street.stripes)
    height, width = camera.size
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    turn = rotation.T.astype(np.float32)
    directions = (camera.rays(columns.ravel(), rows.ravel()) @ turn).astype(np.float32)
    hits = _cast(caster, directions)
    # Directions have z = 1 in the camera frame, so the hit parameter is the depth itself.
    solid = hits.face >= 0
    depth = np.where(solid, hits.distance, 0).astype(np.float32).reshape(camera.size)
    label = np.where(solid, mesh.label[hits.face], np.uint8(SceneClass.SKY)).astype(np.uint8)

    openness = _openness(caster, hits, directions, camera.size, rng)
    light = partial(shade, caster, pixel_angle=1.0 / camera.focal_px, weather=weather, rng=rng)
    radiance = light(hits, directions, openness=openness)
    rough = np.flatnonzero(_edges(depth, radiance.reshape(height, width, 3)))
    total = radiance[rough].clip(0, 3)
    for dx, dy in _JITTER:
        rays = camera.rays(columns.ravel()[rough] + dx, rows.ravel()[rough] + dy) @ turn
        rays = rays.astype(np.float32)
        total += light(_cast(caster, rays), rays, openness=openness[rough]).clip(0, 3)
    radiance[rough] = total / (1 + len(_JITTER))

    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ position
    rgb = _expose(radiance.reshape(height, width, 3), weather, rng)
    scan = scan_street(caster, camera, rotation, mount, lidar_rng)
    label = label.reshape(camera.size)
    return RenderedFrame(rgb, depth, label, world_to_camera, camera.intrinsics, scan)


def _expose(radiance: Floats, weather: Weather, rng: Generator) -> NDArray[np.uint8]:
    """Return the picture, uint8 (H, W, 3) RGB, of linear radiance (H, W, 3).

    It has automatic exposure on the lower part of the picture (which a driver's camera meters), a
    soft shoulder, vignette, slight blur, shot and read noise, and a gamma like sRGB.
    """
    height, width = radiance.shape[:2]
    metered = radiance[height // 3 :: 4, ::4].mean(axis=2)
    key = float(np.exp(np.log(metered + 1e-3).mean()))
    image: Floats = radiance * np.float32(0.17 / key * 2.0**weather.exposure)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    image *= (1 - 0.16 * (0.5 * x * x + 0.5 * y * y))[..., None]
    image = np.asarray(cv2.GaussianBlur(image, (3, 3), 0.48))
    shot = np.sqrt(np.clip(image, 0, 1)) * weather.noise + 0.4 * weather.noise
    image = image + shot * rng.standard_normal(image.shape, dtype=np.float32)
    image = np.clip(image, 0, None)
    # Linear up to 0.6; brighter values approach 1 exponentially.
    bright = np.where(image < 0.6, image, 0.6 + 0.4 * (1 - np.exp(-(image - 0.6) / 0.4)))
    return (255 * np.clip(bright, 0, 1) ** (1 / 2.2) + 0.5).astype(np.uint8)


def _cast(caster: RayCaster, directions: Floats) -> Hits:
    hits = caster.first_hit(np.zeros_like(directions), directions)
    far = hits.distance > MAX_DEPTH_M
    face = np.where(far, np.int32(-1), hits.face)
    return Hits(np.where(face < 0, np.float32(MAX_DEPTH_M), hits.distance), face, hits.u, hits.v)


def _openness(
    caster: RayCaster, hits: Hits, directions: Floats, size: tuple[int, int], rng: Generator
) -> Floats:
    """Return contact shading, computed on every second row and column, smoothed, at full size."""
    height, width = size
    pick = np.arange(height * width).reshape(size)[::2, ::2].ravel()
    free = np.ones(len(pick), dtype=np.float32)
    near = np.flatnonzero((hits.face[pick] >= 0) & (hits.distance[pick] < 60))
    chosen, view = hits.take(pick[near]), directions[pick[near]]
    normal = caster.normals(chosen, view)
    point = view * chosen.distance[:, None] + normal * np.float32(0.01)
    free[near] = contact_shading(caster, point, normal, rng)
    coarse = free.reshape(-(-height // 2), -(-width // 2))
    smooth = cv2.blur(coarse, (5, 5))
    full = cv2.resize(smooth, (coarse.shape[1] * 2, coarse.shape[0] * 2))[:height, :width]
    return (0.12 + 0.88 * full).ravel().astype(np.float32)


def _edges(depth: Floats, radiance: Floats) -> NDArray[np.bool_]:
    """Return the pixels (H * W,) next to a jump of depth or brightness, which need more rays."""
    inverse = 1.0 / np.where(depth > 0, depth, 1e3).astype(np.float32)
    cross = np.ones((3, 3), np.uint8)
    jump = (cv2.dilate(inverse, cross) - cv2.erode(inverse, cross)) > 0.06 * inverse + 2e-4
    tone = np.log(radiance.mean(axis=2) + 0.02)
    contrast = (cv2.dilate(tone, cross) - cv2.erode(tone, cross)) > 0.45
    return np.asarray((jump | contrast).ravel())
