"""Lenses against OpenCV: projection into the distorted image, and back along the rays."""

import cv2
import numpy as np
import pytest

from runtime import InputError, project_points
from runtime.engine.prediction import Latency, Prediction
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import Lens, cache_key, rays
from runtime.geometry.motion import project_compensated
from runtime.geometry.point_cloud import depth_to_cloud
from runtime.geometry.poses import PoseTrack

K = np.array([[420.0, 0.4, 318.3], [0, 418, 243.6], [0, 0, 1]])
SIZE = (480, 640)
# Of 160 degrees from left to right: 320 pixels are 80 degrees.
FISHEYE = np.array([[229.0, 0, 319.5], [0, 229, 239.5], [0, 0, 1]])
LENSES = [
    pytest.param(K, "plumb_bob", (-0.28, 0.074, 2e-3, -1e-3), id="plumb_bob 4"),
    pytest.param(K, "plumb_bob", (-0.28, 0.074, 2e-3, -1e-3, 0.01), id="plumb_bob"),
    pytest.param(
        K, "rational_polynomial", (0.6, -0.02, 1e-3, 2e-4, 1e-3, 0.95, 0.06, 2e-3), id="rational"
    ),
    pytest.param(FISHEYE, "equidistant", (0.01, -0.004, 1e-3, -2e-4), id="equidistant"),
    pytest.param(FISHEYE, "equidistant", (0, 0, 0, 0), id="equidistant of zeros"),
]


def by_opencv(points, intrinsics, model, coefficients):
    """The pixels (u, v) of points in the camera's frame."""
    points, nothing = np.asarray(points, np.float64)[:, None], np.zeros(3)
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    pixels, _ = project(points, nothing, nothing, np.eye(3), np.array(coefficients, np.float64))
    return pixels[:, 0] @ intrinsics[:2, :2].T + intrinsics[:2, 2]


def scattered(size=SIZE, *, count=4000, seed=0):
    """Points before the camera, out to 85 degrees from its axis, float32 (N, 3)."""
    rng = np.random.default_rng(seed)
    angle, around = np.deg2rad(rng.uniform(0, 85, count)), rng.uniform(0, 2 * np.pi, count)
    ray = [np.tan(angle) * np.cos(around), np.tan(angle) * np.sin(around), np.ones(count)]
    return (np.stack(ray) * rng.uniform(2, 80, count)).T.astype(np.float32)


@pytest.mark.parametrize(("intrinsics", "model", "coefficients"), LENSES)
def test_rays_and_pixels_are_those_of_opencv(intrinsics, model, coefficients):
    lens = Lens(model, coefficients)
    points = scattered()
    x, y = (points[:, :2] / points[:, 2:]).T
    table = rays(lens, cache_key(intrinsics), SIZE)
    seen = np.isfinite(table[..., 0])
    assert seen.mean() > 0.95
    row, column = np.nonzero(seen)
    ahead = np.column_stack([table[seen], np.ones(seen.sum())])
    expected = by_opencv(ahead, intrinsics, model, coefficients)
    np.testing.assert_allclose(expected, np.column_stack([column, row]), atol=1e-3)

    distorted = lens.distort(x, y)
    assert distorted[0].dtype == np.float32
    pixels = np.stack(distorted, axis=1) @ intrinsics[:2, :2].T + intrinsics[:2, 2]
    expected = by_opencv(points, intrinsics, model, coefficients)
    inside = ((expected > -1) & (expected < SIZE[::-1])).all(axis=1)
    assert inside.sum() > 500
    np.testing.assert_allclose(pixels[inside], expected[inside], atol=0.01)


@pytest.mark.parametrize(("intrinsics", "model", "coefficients"), LENSES)
def test_a_cloud_goes_back_along_the_rays(intrinsics, model, coefficients):
    """Returns that lie on the rays of pixels come back to 1 mm, and fall into their pixels."""
    lens = Lens(model, coefficients)
    depth = np.random.default_rng(2).uniform(1, 20, SIZE).astype(np.float32)
    depth[0, :3] = 0, np.nan, np.inf
    cloud = depth_to_cloud(depth, intrinsics, lens=lens)
    pixels = by_opencv(cloud.points, intrinsics, model, coefficients)
    np.testing.assert_allclose(pixels, np.column_stack([cloud.columns, cloud.rows]), atol=5e-3)
    back = project_points(cloud.points, intrinsics, np.eye(4), SIZE, lens=lens)
    at = cloud.rows, cloud.columns
    np.testing.assert_allclose(back[at], depth[at], rtol=1e-6)
    again = depth_to_cloud(back, intrinsics, lens=lens)
    np.testing.assert_allclose(again.points, cloud.points, atol=1e-3)


def test_moved_scans_and_predicted_clouds_take_the_lens():
    calibration = Calibration(
        FISHEYE, np.eye(4), SIZE, lens="equidistant", distortion=[0.01, -0.004, 1e-3, -2e-4]
    )
    ahead = np.eye(4)
    ahead[2, 3] = 0.5
    track = PoseTrack.of([np.eye(4), ahead], [0, 10**8])
    points = scattered()
    points = points[points[:, 2] > 1]
    for times in (0, np.zeros(len(points), np.int64)):
        moved = project_compensated(calibration, points, times, track, 10**8, SIZE)
        nearer = points - np.float32([0, 0, 0.5])
        assert np.mean(moved == calibration.project(nearer, SIZE)) > 0.999  # borders of pixels

    depth = np.full(SIZE, 7, np.float32)
    prediction = Prediction({"depth": depth}, SIZE, SIZE, Latency(0, 0, 0, 0))
    expected = depth_to_cloud(depth, FISHEYE, lens=calibration.lens_model)
    np.testing.assert_array_equal(prediction.points(calibration).points, expected.points)
    with pytest.raises(InputError, match="scale the intrinsics"):
        prediction.points(Calibration(K, np.eye(4), (470, 640)))


@pytest.mark.parametrize(("model", "coefficients", "end_deg"), [
    # 1 + 3 k1 r^2 = 0
    ("plumb_bob", (-0.35, 0, 0, 0, 0), np.rad2deg(np.arctan(np.sqrt(1 / 1.05)))),
    ("rational_polynomial", (-0.35, 0, 0, 0, 0, 0, 0, 0), 44.3),
    # A pole at r = 1; the radius is negative beyond it.
    ("rational_polynomial", (0, 0, 0, 0, 0, -1.0, 0, 0), 45.0),
    # 1 - 3 * 0.3 angle^2 = 0
    ("equidistant", (-0.3, 0, 0, 0), np.rad2deg(np.sqrt(1 / 0.9))),
])  # fmt: skip
def test_nothing_folds_back_into_the_image(model, coefficients, end_deg):
    intrinsics = np.array([[150.0, 0, 319.5], [0, 150, 239.5], [0, 0, 1]])
    lens = Lens(model, coefficients)
    angle = np.deg2rad(np.arange(0.5, 89.5, 1.0))
    points = np.stack([np.tan(angle), 0 * angle, 1 + 0 * angle], axis=1).astype(np.float32)
    seen = [project_points(p[None], intrinsics, np.eye(4), SIZE, lens=lens) for p in points]
    columns = [np.nonzero(depth)[1] for depth in seen]
    inside = np.array([len(column) == 1 for column in columns])
    assert not inside[np.rad2deg(angle) > end_deg + 0.01].any()
    found = np.concatenate(columns)
    assert (np.diff(found) >= 0).all()
    assert (found > 319).all()
    # Pixels that no ray meets have no point.
    depth = np.ones(SIZE, np.float32)
    cloud = depth_to_cloud(depth, intrinsics, lens=lens)
    farthest = np.rad2deg(np.arctan(np.hypot(cloud.points[:, 0], cloud.points[:, 1])).max())
    assert farthest <= end_deg + 0.01


@pytest.mark.parametrize(("model", "distortion"), [
    ("brown", [0, 0, 0, 0]), ("plumb_bob", [0.1]), ("equidistant", [0.1, 0, 0, np.nan]),
    ("plumb_bob", "many"), ("plumb_bob", None), (None, [0.1] * 5), ("plumb_bob", [0] * 13 + [0.1]),
])  # fmt: skip
def test_what_is_no_lens(model, distortion):
    with pytest.raises(InputError, match=r"lens|distortion"):
        Calibration(K, np.eye(4), lens=model, distortion=distortion)


def test_zeros_beyond_the_coefficients_of_a_model_do_nothing():
    first = (-0.3, 0.1, 0.001, -0.002, 0.01)
    assert Lens.of("plumb_bob", [*first, *[0.0] * 9]).coefficients == first


def test_a_rectified_image_shows_what_the_rectified_calibration_projects():
    """A dot at the pixel of a return, in the image as in the rectified one."""
    calibration = Calibration(
        K, np.eye(4), SIZE, lens="plumb_bob", distortion=[-0.28, 0.074, 2e-3, -1e-3, 0.01]
    )
    for point in np.array([[0.4, -0.3, 1], [-0.5, 0.2, 1], [0.0, 0.4, 1]], np.float32) * 10:
        rgb = np.zeros((*SIZE, 3), np.uint8)
        seen = calibration.project(point[None], SIZE) > 0
        rgb[cv2.dilate(seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = 255
        straight = calibration.rectify(rgb)
        assert straight.shape == rgb.shape
        row, column = np.nonzero(straight[..., 0] > 127)
        ((v, u),) = np.argwhere(calibration.rectified.project(point[None], SIZE) > 0)
        # Both projections round to a pixel.
        np.testing.assert_allclose([row.mean(), column.mean()], [v, u], atol=1.2)
    assert calibration.rectified.lens_model is None
    assert calibration.rectified.rectify(rgb) is rgb
    with pytest.raises(InputError, match="scale the intrinsics"):
        calibration.rectify(np.zeros((10, 10, 3), np.uint8))
