"""Rendered frames and LiDAR scans against hand-made scenes whose contents can be computed."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from training.scenes.layout.site import Centreline
from training.scenes.layout.street import Street, build_street
from training.scenes.layout.traffic import Actor
from training.scenes.names import SceneClass, StreetKind, Variant
from training.scenes.rendering.camera import make_camera
from training.scenes.rendering.lidar_scan import LidarMount, LidarScan, draw_mount
from training.scenes.rendering.render import RenderedFrame, render_frame
from training.scenes.rendering.weather import draw_weather
from training.scenes.scene_job import SceneJob, render_frames
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, box, join, polygon

STRAIGHT = np.arange(-50.0, 400.0)
LINE = Centreline(STRAIGHT, STRAIGHT, 0 * STRAIGHT, 0 * STRAIGHT, 0 * STRAIGHT)
ROAD = Look(SurfaceKind.PLAIN, (0.2, 0.2, 0.2), SceneClass.ROAD)
WALL = Look(SurfaceKind.PLAIN, (0.5, 0.5, 0.5), SceneClass.BUILDING)
GROUND = polygon([(-40, -200, 0), (300, -200, 0), (300, 200, 0), (-40, 200, 0)], ROAD)
CAMERA = make_camera("kitti", (96, 318))
WHITE = Look(SurfaceKind.PLAIN, (0.8, 0.8, 0.8), SceneClass.BUILDING)
GLASS = Look(SurfaceKind.CAR_GLASS, (0.02, 0.02, 0.02), SceneClass.CAR)
LARGE = make_camera("kitti", (188, 621))
MOUNT = draw_mount(CAMERA, np.random.default_rng(0))
# sway 0 leaves the camera level at time 0.
LEVEL = {"time": 0.0, "sway": 0.0}


def hand_made_street(*meshes) -> Street:
    return Street(LINE, join(*meshes), (), (), ego_d=0.0, ego_speed=10.0)


def rendered(street, light="overcast", camera=CAMERA, mount=MOUNT, **pose):
    weather = draw_weather(light, 1) if isinstance(light, str) else light
    rng = np.random.default_rng(0)
    return render_frame(street, camera, weather, mount, rng=rng, **{**LEVEL, **pose})


def scanned(*meshes, seed: int = 0, mount: LidarMount | None = None) -> RenderedFrame:
    mount = mount or draw_mount(LARGE, np.random.default_rng(seed))
    return rendered(hand_made_street(*meshes), camera=LARGE, mount=mount)


def across(distance_m: float, look: Look = WHITE, half_m: float = 60.0):
    """A wall across the street, as seen from the camera at the origin."""
    corners = [(half_m, -9), (-half_m, -9), (-half_m, 60), (half_m, 60)]
    return polygon([(distance_m, y, z) for y, z in corners], look)


def in_camera(scan: LidarScan) -> np.ndarray:
    return scan.points[:, :3] @ scan.to_camera[:3, :3].T + scan.to_camera[:3, 3]


def test_depth_of_flat_ground_follows_from_the_camera_height():
    frame = rendered(hand_made_street(GROUND))
    for row in (60, 75, 95):
        expected = CAMERA.mount_height_m * CAMERA.focal_px / (row - CAMERA.cy)
        assert frame.depth[row, 150] == pytest.approx(expected, rel=1e-4)
    assert not frame.depth[:40].any()
    assert (frame.label[:40] == SceneClass.SKY).all()
    assert (frame.label[60:] == SceneClass.ROAD).all()
    wall = rendered(hand_made_street(across(20, half_m=100)))  # not along the ray
    assert wall.depth.dtype == np.float32
    assert np.allclose(wall.depth, 20.0, atol=1e-3)


def test_a_thing_ahead_appears_where_the_pinhole_puts_it():
    post = box((0.2, 1.0, 2.0), (30.1, -3.0, 1.0), replace(WALL, label=SceneClass.POLE))
    frame = rendered(hand_made_street(GROUND, post))
    rows, columns = np.nonzero(frame.label == SceneClass.POLE)
    # The front face is 30 m ahead, 2.5 to 3.5 m to the right, 0 to 2 m up.
    x, y = CAMERA.focal_px * np.array([[2.5, 3.5], [-0.35, 1.65]]) / 30
    assert np.allclose((columns.min(), columns.max()), CAMERA.cx + x, atol=1, rtol=0)
    assert np.allclose((rows.min(), rows.max()), CAMERA.cy + y, atol=1, rtol=0)
    assert np.allclose(frame.depth[rows, columns], 30.0, atol=0.21)


def test_sun_throws_a_shadow_and_an_overcast_sky_does_not():
    roof = polygon([(11, 3, 3), (11, -3, 3), (25, -3, 3), (25, 3, 3)], WALL)
    street = hand_made_street(GROUND, roof)
    overhead = replace(draw_weather("clone", 1), sun_direction=(0.0, 0.0, 1.0), noise=0.0)
    shade_row = round(CAMERA.cy + CAMERA.focal_px * 1.65 / 15)
    spot, beside = (shade_row, round(CAMERA.cx)), (shade_row, 300)

    def brightness(weather):
        frame = rendered(street, weather)
        return frame.rgb[spot].mean() / frame.rgb[beside].mean()

    assert brightness(overhead) < 0.6
    assert brightness(replace(overhead, sun=(0.0, 0.0, 0.0))) > 0.85


@pytest.fixture(scope="module")
def town():
    return build_street(22, kind="town")


def test_poses_and_depth_of_a_stream_fit_together(town):
    """Static points of one frame, moved by the poses, meet the depth of a later frame."""
    street = replace(town, actors=())
    camera = make_camera("kitti", (94, 310))
    first, second = (rendered(street, camera=camera, time=t, sway=5.0) for t in (0.0, 0.4))
    rows, columns = np.nonzero((first.depth > 4) & (first.depth < 40))
    z = first.depth[rows, columns]
    local = np.linalg.inv(camera.intrinsics) @ [columns * z, rows * z, z]
    motion = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    moved = motion[:3, :3] @ local + motion[:3, 3:]
    u, v = np.rint((camera.intrinsics @ moved / moved[2])[:2]).astype(int)
    seen = (moved[2] > 1) & (u >= 0) & (u < 310) & (v >= 0) & (v < 94)
    there = second.depth[v[seen], u[seen]]
    assert seen.sum() > 5000
    assert np.median(np.abs(there - moved[2][seen]) / moved[2][seen]) < 0.01
    assert (second.label[v[seen], u[seen]] == first.label[rows, columns][seen]).mean() > 0.85
    assert first.world_to_camera[2, 3] - second.world_to_camera[2, 3] > 0.5


def test_same_job_same_bytes_other_seed_other_street():
    job = SceneJob(22, Variant.rain, 1, 0.1, (60, 80), kind=StreetKind.highway)
    once, again = (next(render_frames(job)) for _ in range(2))
    for name in ("rgb", "depth", "label", "world_to_camera"):
        assert getattr(once, name).tobytes() == getattr(again, name).tobytes()
    other = next(render_frames(replace(job, seed=23)))
    assert not np.array_equal(once.depth, other.depth)


def test_things_move_at_their_speed():
    label = replace(WALL, label=SceneClass.CAR)
    car = polygon([(2, -1, 1), (-2, -1, 1), (-2, 1, 1), (2, 1, 1)], label)
    ahead = Actor(lambda _: car, s=10.0, d=-2.0, speed=6.0, turned=0.0)
    crossing = Actor(lambda _: car, s=10.0, d=-2.0, speed=0.0, turned=np.pi / 2, across=1.5)
    middle = [a.at(0.5, LINE).positions.mean(axis=(0, 1)) for a in (ahead, crossing)]
    start = ahead.at(0.0, LINE).positions.mean(axis=(0, 1))
    assert np.allclose(middle[0] - start, (3.0, 0, 0), atol=1e-5)
    assert np.allclose(middle[1] - crossing.at(0.0, LINE).positions.mean(axis=(0, 1)), (0, 0.75, 0))
    street = replace(hand_made_street(GROUND), actors=(ahead,), ego_speed=0.0)
    frames = rendered(street), rendered(street, time=1)
    now, later = (frame.depth[frame.label == SceneClass.CAR].mean() for frame in frames)
    assert later - now == pytest.approx(6.0, abs=1.0)


def test_streets_hold_every_class():
    found = set()
    for kind in StreetKind:
        street = build_street(1, kind=kind)
        for mesh in (street.standing, *(actor.pose(0.3) for actor in street.actors)):
            found |= set(np.unique(mesh.label).tolist())
    assert found | {SceneClass.SKY} == set(SceneClass)


def test_traffic_keeps_to_its_side():
    for seed, sign in ((22, -1.0), (20, 1.0)):  # every fifth seed keeps left
        street = build_street(seed, kind="highway")
        assert np.sign(street.ego_d) == sign
        lanes = [a for a in street.actors if not a.cycle and abs(a.turned) < 0.1 and a.speed > 0]
        assert lanes
        assert all(np.sign(a.d) == sign for a in lanes)


def test_variants_differ_in_light_only_and_lidars_not_in_the_picture(town):
    camera = make_camera("kitti", (60, 80))
    frames = [rendered(town, variant, camera=camera) for variant in Variant]
    assert all(np.array_equal(frame.depth, frames[0].depth) for frame in frames)
    assert all(np.array_equal(frame.label, frames[0].label) for frame in frames)
    assert len({frame.rgb.tobytes() for frame in frames}) == len(Variant)
    varied = draw_mount(LARGE, np.random.default_rng(1), varied=True)
    other = rendered(town, next(iter(Variant)), camera=camera, mount=varied)
    assert len(other.scan.points) != len(frames[0].scan.points)
    assert other.rgb.tobytes() == frames[0].rgb.tobytes()


def test_returns_are_on_the_wall_in_the_picture_seen_from_the_lidars_position():
    frame = scanned(across(20.0))
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
    u, v = (LARGE.intrinsics @ (seen / seen[:, 2:]).T)[:2]
    height, width = LARGE.size
    assert ((u > -0.51) & (u < width - 0.49) & (v > -0.51) & (v < height - 0.49)).all()


def test_a_varied_lidar_has_its_own_lines_in_order_and_is_elsewhere():
    mounts = [draw_mount(LARGE, np.random.default_rng(s), varied=True) for s in range(40)]
    assert {len(mount.elevations_deg) for mount in mounts} == {32, 40, 64, 128}
    ratios = []
    for mount in mounts:
        spacing = -np.diff(mount.elevations_deg)
        assert spacing.min() > -0.2  # but for the noise
        assert 1.5 < mount.elevations_deg[0] < 15.5
        assert -30.5 < mount.elevations_deg[-1] < -14.5
        level = np.argmin(np.abs(mount.elevations_deg))
        ratios.append(spacing[level - 2 : level + 3].mean() / spacing[-5:].mean())
    # Some are denser at the horizon, some are even.
    assert min(ratios) < 0.5 < 0.8 < max(ratios)
    behind = [-mount.to_camera[2, 3] for mount in mounts]
    assert min(behind) < 0.4 < 1.0 < max(behind)


def test_rings_come_from_the_top_each_counter_clockwise_from_straight_ahead():
    points = scanned(across(20.0)).scan.points
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    ring = np.concatenate([[0], np.cumsum(np.diff(azimuth) < -5)])
    elevation = np.degrees(np.arcsin(points[:, 2] / np.linalg.norm(points[:, :3], axis=1)))
    means = [elevation[ring == number].mean() for number in range(ring.max() + 1)]
    assert 20 < len(means) <= 64
    assert (np.diff(means) < 0).all()
    assert max(elevation[ring == number].std() for number in range(len(means))) < 0.15


def test_most_pulses_go_through_a_pane_or_are_lost_at_it():
    """A pane at 10 m before a wall at 30 m; a wall of the same colour instead stops all of them."""
    through = in_camera(scanned(across(10.0, GLASS, half_m=9), across(30.0)).scan)[:, 2]
    stopped = replace(GLASS, kind=SurfaceKind.PLAIN)
    solid = in_camera(scanned(across(10.0, stopped, half_m=9), across(30.0)).scan)[:, 2]
    clear = in_camera(scanned(across(30.0)).scan)
    behind = np.abs(clear[:, 0]) < 0.8 * 9 * 3  # seen through the pane from near its middle
    passed = (through > 29).sum() - (clear[:, 2] > 29)[~behind].sum()
    assert 0.45 < passed / behind.sum() < 0.75
    assert 0.02 < (through < 11).sum() / (solid < 11).sum() < 0.2


def test_far_and_dark_surfaces_return_less():
    near = len(scanned(across(20.0)).scan.points)
    far = len(scanned(across(100.0)).scan.points)
    dark = len(scanned(across(45.0, replace(WHITE, color=(0.02, 0.02, 0.02)))).scan.points)
    bright = len(scanned(across(45.0)).scan.points)
    assert far < 0.9 * near
    assert dark < 0.4 * bright
    assert not len(scanned(across(130.0)).scan.points)


def test_varied_cameras_differ_by_scene_and_are_the_same_again():
    cameras = [make_camera("varied", (1, 1), seed) for seed in range(30)]
    assert cameras == [make_camera("varied", (1, 1), seed) for seed in range(30)]
    assert len({camera.size for camera in cameras}) > 2
    view_deg = [2 * np.degrees(np.arctan(c.size[1] / 2 / c.focal_px)) for c in cameras]
    assert 44 < min(view_deg) < max(view_deg) - 30 < 76
