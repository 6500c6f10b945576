"""The LiDAR of rendered scenes against hand-made streets whose ranges can be computed."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from training.scenes.layout.site import Centreline
from training.scenes.layout.street import Street, build_street
from training.scenes.names import SceneClass
from training.scenes.rendering.camera import make_camera
from training.scenes.rendering.lidar_scan import LidarMount, LidarScan, draw_mount
from training.scenes.rendering.render import RenderedFrame, render_frame
from training.scenes.rendering.weather import draw_weather
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, join, polygon
from training.scenes.vkitti_writer import write_variant

ALONG = np.arange(-50.0, 400.0)
LINE = Centreline(ALONG, ALONG, 0 * ALONG, 0 * ALONG, 0 * ALONG)
WHITE = Look(SurfaceKind.PLAIN, (0.8, 0.8, 0.8), SceneClass.BUILDING)
GLASS = Look(SurfaceKind.CAR_GLASS, (0.02, 0.02, 0.02), SceneClass.CAR)
CAMERA = make_camera("kitti", (188, 621))


def wall(distance_m: float, look: Look = WHITE, half_m: float = 60.0):
    """A wall across the street, as seen from the camera at the origin."""
    corners = [(half_m, -9), (-half_m, -9), (-half_m, 60), (half_m, 60)]
    return polygon([(distance_m, y, z) for y, z in corners], look)


def rendered(*meshes, seed: int = 0, mount: LidarMount | None = None) -> RenderedFrame:
    return render_frame(
        Street(LINE, join(*meshes), (), (), ego_d=0.0, ego_speed=10.0),
        CAMERA,
        draw_weather("overcast", 1),
        mount or draw_mount(CAMERA, np.random.default_rng(seed)),
        time=0.0,
        sway=0.0,
        rng=np.random.default_rng(0),
    )


def in_camera(scan: LidarScan) -> np.ndarray:
    return scan.points[:, :3] @ scan.to_camera[:3, :3].T + scan.to_camera[:3, 3]


def test_returns_are_on_the_wall_seen_from_the_lidars_position():
    frame = rendered(wall(20.0))
    seen = in_camera(frame.scan)
    assert len(seen) > 5000
    assert frame.scan.points.dtype == np.float32
    # Noise is along the ray: a share of it is across the wall.
    assert np.abs(seen[:, 2] - 20.0).max() < 0.15
    assert seen[:, 2].std() == pytest.approx(0.02, abs=0.006)
    ranges = np.linalg.norm(frame.scan.points[:, :3], axis=1)
    behind_m = -frame.scan.to_camera[2, 3]
    assert behind_m > 0
    assert ranges.min() > 20.0 + behind_m - 0.15


def test_every_return_falls_into_the_picture():
    scan = rendered(wall(20.0)).scan
    x, y, z = in_camera(scan).T
    u, v = CAMERA.cx + CAMERA.focal_px * x / z, CAMERA.cy + CAMERA.focal_px * y / z
    height, width = CAMERA.size
    assert ((u > -0.51) & (u < width - 0.49) & (v > -0.51) & (v < height - 0.49)).all()


def test_a_varied_lidar_has_its_own_lines_in_order_and_is_elsewhere():
    mounts = [draw_mount(CAMERA, np.random.default_rng(s), varied=True) for s in range(40)]
    assert {len(mount.elevations_deg) for mount in mounts} == {32, 40, 64, 128}
    for mount in mounts:
        spacing = -np.diff(mount.elevations_deg)
        assert spacing.min() > -0.2  # but for the noise
        assert 1.5 < mount.elevations_deg[0] < 15.5
        assert -30.5 < mount.elevations_deg[-1] < -14.5
    # Some are denser at the horizon, some are even.
    ratios = []
    for mount in mounts:
        spacing = -np.diff(mount.elevations_deg)
        level = np.argmin(np.abs(mount.elevations_deg))
        ratios.append(spacing[level - 2 : level + 3].mean() / spacing[-5:].mean())
    assert min(ratios) < 0.5 < 0.8 < max(ratios)
    behind = [-mount.to_camera[2, 3] for mount in mounts]
    assert min(behind) < 0.4 < 1.0 < max(behind)


def test_the_scan_of_a_varied_lidar_is_on_the_wall():
    mount = draw_mount(CAMERA, np.random.default_rng(7), varied=True)
    frame = rendered(wall(20.0), mount=mount)
    seen = in_camera(frame.scan)
    assert np.abs(seen[:, 2] - 20.0).max() < 0.15
    points = frame.scan.points
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    rings = 1 + np.count_nonzero(np.diff(azimuth) < -5)
    visible = np.abs(np.tan(np.deg2rad(mount.elevations_deg))) * 20 < 7
    assert 0.6 * visible.sum() < rings <= len(mount.elevations_deg)


def test_rings_come_from_the_top_each_counter_clockwise_from_straight_ahead():
    points = rendered(wall(20.0)).scan.points
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    ring = np.concatenate([[0], np.cumsum(np.diff(azimuth) < -5)])
    elevation = np.degrees(np.arcsin(points[:, 2] / np.linalg.norm(points[:, :3], axis=1)))
    means = [elevation[ring == number].mean() for number in range(ring.max() + 1)]
    assert 20 < len(means) <= 64
    assert (np.diff(means) < 0).all()
    assert max(elevation[ring == number].std() for number in range(len(means))) < 0.15


def test_most_pulses_go_through_a_pane_or_are_lost_at_it():
    """A pane at 10 m before a wall at 30 m; a wall of the same colour instead stops all of them."""
    through = in_camera(rendered(wall(10.0, GLASS, half_m=9), wall(30.0)).scan)[:, 2]
    stopped = replace(GLASS, kind=SurfaceKind.PLAIN)
    solid = in_camera(rendered(wall(10.0, stopped, half_m=9), wall(30.0)).scan)[:, 2]
    clear = in_camera(rendered(wall(30.0)).scan)[:, 2]
    wide = in_camera(rendered(wall(30.0)).scan)
    behind = np.abs(wide[:, 0]) < 0.8 * 9 * 3  # seen through the pane from near its middle
    passed = (through > 29).sum() - (clear > 29)[~behind].sum()
    assert 0.45 < passed / behind.sum() < 0.75
    assert 0.02 < (through < 11).sum() / (solid < 11).sum() < 0.2


def test_it_looks_past_near_things_that_hide_their_background_from_the_camera():
    """The LiDAR is above the camera: over the top of a low wall it sees the ground behind."""
    ground = polygon([(-40, -200, 0), (300, -200, 0), (300, 200, 0), (-40, 200, 0)], WHITE)
    low = polygon([(8, 30, 0), (8, -30, 0), (8, -30, 1.4), (8, 30, 1.4)], WHITE)
    mounts = [seed for seed in range(20) if _rise_m(seed) > 0.25]
    frame = rendered(ground, low, seed=mounts[0])
    x, y, z = in_camera(frame.scan).T
    u = np.rint(CAMERA.cx + CAMERA.focal_px * x / z).astype(int).clip(0, CAMERA.size[1] - 1)
    v = np.rint(CAMERA.cy + CAMERA.focal_px * y / z).astype(int).clip(0, CAMERA.size[0] - 1)
    on_the_wall = np.abs(frame.depth[v, u] - 8.0) < 0.01
    assert ((z > 13) & on_the_wall).sum() > 20


def _rise_m(seed: int) -> float:
    return -float(draw_mount(CAMERA, np.random.default_rng(seed)).to_camera[1, 3])


def test_far_and_dark_surfaces_return_less():
    near = len(rendered(wall(20.0)).scan.points)
    far = len(rendered(wall(100.0)).scan.points)
    dark = len(rendered(wall(45.0, replace(WHITE, color=(0.02, 0.02, 0.02)))).scan.points)
    bright = len(rendered(wall(45.0)).scan.points)
    assert far < 0.9 * near
    assert dark < 0.4 * bright
    assert not len(rendered(wall(130.0)).scan.points)


def test_the_picture_does_not_depend_on_the_lidar():
    street = [build_street(22, kind="town").standing]
    other = draw_mount(CAMERA, np.random.default_rng(1), varied=True)
    frames = rendered(*street), rendered(*street, mount=other)
    assert len(frames[0].scan.points) != len(frames[1].scan.points)
    assert frames[0].rgb.tobytes() == frames[1].rgb.tobytes()


def test_scans_are_written_beside_the_frames(tmp_path):
    frame = rendered(wall(20.0))
    folder = write_variant(tmp_path / "Scene01/clone", [frame])
    stored = np.fromfile(folder / "frames/lidar/Camera_0/lidar_00000.bin", "<f4").reshape(-1, 4)
    assert np.array_equal(stored, frame.scan.points)
    name, numbers = (folder / "calib.txt").read_text().split(":")
    assert name == "Tr_velo_to_cam"
    matrix = np.array(numbers.split(), np.float64).reshape(3, 4)
    assert np.allclose(matrix, frame.scan.to_camera[:3], atol=1e-8)


def test_varied_cameras_differ_by_scene_and_are_the_same_again():
    cameras = [make_camera("varied", (1, 1), seed) for seed in range(30)]
    assert cameras == [make_camera("varied", (1, 1), seed) for seed in range(30)]
    assert len({camera.size for camera in cameras}) > 2
    view_deg = [2 * np.degrees(np.arctan(c.size[1] / 2 / c.focal_px)) for c in cameras]
    assert min(view_deg) > 44
    assert max(view_deg) < 106
    assert max(view_deg) - min(view_deg) > 30
