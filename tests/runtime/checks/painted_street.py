"""A painted street: boxes on a road, whose depth and boundaries are known exactly."""

from types import SimpleNamespace

import cv2
import numpy as np

from runtime.checks.fit import rotation
from runtime.checks.judge import Judge
from runtime.geometry.calibration import Calibration
from runtime.streams.frame import Frame
from runtime.streams.frame_view import view_of
from runtime.streams.messages import Depth, Image, Scan

# From a LiDAR (x ahead, z up), 0.3 m beside the camera, to the camera.
EXTRINSICS = np.array([[0, -1, 0, 0.3], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
FOCAL, SIZE = 240.0, (120, 360)


def turned_extrinsics(angles, given=EXTRINSICS):
    """These extrinsics turned by yaw, pitch and roll [degrees]."""
    extrinsics = given.copy()
    extrinsics[:3, :3] = rotation(angles) @ extrinsics[:3, :3]
    return extrinsics


def paint(seed, *, boxes=9):
    """Depth [m], float32 (H, W): a road, a wall at 40 m, and boxes before it."""
    random, (height, width) = np.random.default_rng(seed), SIZE
    rows = np.arange(height)[:, None] - height / 2
    depth = np.broadcast_to(np.minimum(1.7 * FOCAL / np.maximum(rows, 1), 40.0), SIZE).copy()
    for z in np.sort(random.uniform(6, 25, boxes))[::-1]:
        wide, left = random.integers(10, 40), random.integers(0, width - 10)
        top, bottom = random.integers(20, 55), int(height / 2 + 1.7 * FOCAL / z)
        depth[top:bottom, left : left + wide] = z
    return depth.astype(np.float32)


def scan_of(depth, extrinsics=EXTRINSICS):
    """Points of a LiDAR on every third row, as if it stood where the camera stands."""
    row, column = (each.ravel() for each in np.mgrid[1 : SIZE[0] : 3, 0 : SIZE[1]])
    z = depth[row, column]
    x, y = (column - SIZE[1] / 2) / FOCAL * z, (row - SIZE[0] / 2) / FOCAL * z
    in_camera = np.stack([x, y, z], axis=1) - extrinsics[:3, 3]
    return np.ascontiguousarray(in_camera @ extrinsics[:3, :3], np.float32)


def street_frame(seed, given=EXTRINSICS, *, right=EXTRINSICS, points=None, boxes=9):
    """A frame whose calibration has the extrinsics `given`, and whose LiDAR stands `right`."""
    matrix = np.array([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    points = scan_of(paint(seed, boxes=boxes), right) if points is None else points
    image = Image(np.full((*SIZE, 3), seed, np.uint8), stamp_ns=seed * 10**8)
    calibration = Calibration(matrix, given, SIZE)
    return Frame(image, Scan.of(points), calibration=calibration)


def street_answer(seed, *, boxes=9, degraded=()):
    """What a perfect network sees in the image alone."""
    depth = paint(seed, boxes=boxes)
    edges = cv2.morphologyEx(np.log(depth), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.2
    boundary = edges.astype(np.float32)
    return SimpleNamespace(depth=depth, boundary=boundary, valid=True, degraded=degraded)


def street(seed, given=EXTRINSICS, *, beside=None, **frame):
    """The view of a street."""
    return view_of(street_frame(seed, given, **frame), street_answer(seed), beside=beside)


def judged(views, **options):
    """What the frames show."""
    judging = Judge(**options)
    for view in views:
        judging.add(view)
    return judging.judgement()


def street_map(seed, change=lambda depth: depth):
    """The view of a street with a depth map that is changed before it is read."""
    depth = change(paint(seed))
    sparse = np.zeros_like(depth)
    sparse[1::3] = depth[1::3]
    matrix = street_frame(seed).calibration.intrinsics
    calibration = Calibration(matrix, np.eye(4), SIZE)
    frame = Frame(street_frame(seed).image, Depth(sparse), calibration=calibration)
    return view_of(frame, street_answer(seed), depth_scale=256)
