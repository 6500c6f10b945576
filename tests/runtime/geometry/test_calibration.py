"""Calibrations from every kind of file come to the same pixels."""

import numpy as np
import pytest

from runtime.base.errors import InputError
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import Lens

K = np.array([[700.0, 0, 320], [0, 710, 120], [0, 0, 1]])
P2 = np.hstack([K, K @ [[0.06], [-0.01], [0.002]]])
RECTIFY = np.array([[0.99995, 0.01, 0], [-0.01, 0.99995, 0], [0, 0, 1]])
R = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
T = np.array([-0.004, -0.076, -0.27])
SIZE = (240, 640)


def by_hand(rectify=RECTIFY, shift=(0.06, -0.01, 0.002)):
    """The chain, one point at a time: LiDAR, camera 0, rectified, beside, pixel."""

    def pixel(point):
        seen = rectify @ (R @ point + T) + shift
        u, v, w = K @ seen
        return u / w, v / w, w

    return pixel


def numbers(values):
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


@pytest.fixture
def raw(tmp_path):
    (tmp_path / "calib_cam_to_cam.txt").write_text(
        f"calib_time: 09-Jan-2012\nS_rect_02: {numbers(SIZE[::-1])}\n"
        f"R_rect_00: {numbers(RECTIFY)}\nP_rect_02: {numbers(P2)}\n"
    )
    (tmp_path / "calib_velo_to_cam.txt").write_text(f"R: {numbers(R)}\nT: {numbers(T)}\n")
    return tmp_path


def matches(calibration, pixel):
    points = np.random.default_rng(0).uniform([5, -4, -1], [40, 4, 1], (50, 3)).astype(np.float32)
    found = (
        calibration.intrinsics @ (calibration.extrinsics @ np.vstack([points.T, np.ones(50)]))[:3]
    )
    expected = np.array([pixel(point) for point in points])
    np.testing.assert_allclose((found[:2] / found[2]).T, expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(found[2], expected[:, 2], rtol=1e-9)


def test_kitti_raw(raw):
    calibration = Calibration.from_kitti(raw)
    matches(calibration, by_hand())
    assert calibration.size == SIZE
    assert calibration.focal_length_px == 700


@pytest.mark.parametrize("name", ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"])
def test_one_of_the_two_files_of_kitti_raw_is_refused(raw, name):
    with pytest.raises(InputError, match=name):
        Calibration.from_file(raw / name)


def test_kitti_object_odometry_and_depth_selection(tmp_path):
    to_camera = np.hstack([R, T[:, None]])
    (tmp_path / "object.txt").write_text(
        f"P2: {numbers(P2)}\nR0_rect: {numbers(RECTIFY)}\nTr_velo_to_cam: {numbers(to_camera)}\n"
    )
    matches(Calibration.from_kitti(tmp_path / "object.txt"), by_hand())
    (tmp_path / "odometry.txt").write_text(f"P2: {numbers(P2)}\nTr: {numbers(to_camera)}\n")
    matches(Calibration.from_kitti(tmp_path / "odometry.txt"), by_hand(rectify=np.eye(3)))
    (tmp_path / "depth.txt").write_text(f"{numbers(K)} \n")
    selection = Calibration.from_file(tmp_path / "depth.txt")
    np.testing.assert_array_equal(selection.intrinsics, K)
    np.testing.assert_array_equal(selection.extrinsics, np.eye(4))


def extrinsics():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, T
    return matrix


@pytest.mark.parametrize("upper", [False, True], ids=["ROS 2", "ROS 1"])
def test_camera_info(upper):
    projection = np.hstack([K, [[700 * 0.12], [0], [0]]])  # the right camera of two
    raw = K * [[2], [2], [1]]
    info = {"k": raw.ravel(), "d": [0.1] * 5, "p": projection.ravel().tolist(), "height": 240,
            "width": 640}  # fmt: skip
    if upper:
        info = {key.upper() if len(key) == 1 else key: value for key, value in info.items()}
    calibration = Calibration.from_camera_info(info, extrinsics(), rectified=True)
    matches(calibration, by_hand(rectify=np.eye(3), shift=(0.12, 0, 0)))
    assert calibration.size == SIZE
    assert calibration.lens is None
    distorted = Calibration.from_camera_info(
        info | {"distortion_model": "plumb_bob"}, extrinsics(), rectified=False
    )
    np.testing.assert_array_equal(distorted.intrinsics, raw)
    np.testing.assert_array_equal(distorted.extrinsics, extrinsics())
    assert distorted.lens_model == Lens("plumb_bob", (0.1,) * 5)
    with pytest.raises(InputError, match="lens must be one of"):
        Calibration.from_camera_info(info, extrinsics(), rectified=False)


def test_camera_info_of_a_camera_that_was_never_rectified():
    info = {"k": K.ravel(), "p": [0.0] * 12, "d": [0.0] * 4, "height": 0, "width": 0}
    calibration = Calibration.from_camera_info(info, extrinsics(), rectified=False)
    matches(calibration, by_hand(rectify=np.eye(3), shift=(0, 0, 0)))
    assert calibration.size is calibration.lens is None
    fisheye = info | {"distortion_model": "equidistant"}  # no pinhole, even without coefficients
    calibration = Calibration.from_camera_info(fisheye, extrinsics(), rectified=False)
    assert calibration.lens_model == Lens("equidistant", (0, 0, 0, 0))
    with pytest.raises(InputError, match="distortion but no P"):
        Calibration.from_camera_info(info | {"d": [0.1]}, extrinsics(), rectified=True)
    with pytest.raises(InputError, match="neither p nor k"):
        Calibration.from_camera_info({}, np.eye(4), rectified=True)


def test_toml(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(
        f"intrinsics = {K.tolist()}\nextrinsics = {extrinsics().tolist()}\nsize = [240, 640]\n"
    )
    calibration = Calibration.from_toml(path)
    matches(calibration, by_hand(rectify=np.eye(3), shift=(0, 0, 0)))
    assert calibration.size == SIZE
    with pytest.raises(InputError, match="640, 240"):
        calibration.project(np.zeros((0, 3), np.float32), SIZE[::-1])
    common = f'intrinsics = {K.tolist()}\npoints_in = "camera"\n'
    path.write_text(f'{common}lens = "equidistant"\ndistortion = [0.1, 0, 0, 0]\n')
    calibration = Calibration.from_toml(path)
    assert calibration.lens_model == Lens("equidistant", (0.1, 0, 0, 0))
    np.testing.assert_array_equal(calibration.extrinsics, np.eye(4))


@pytest.mark.parametrize("text", [
    'intrinsics = 1\npoints_in = "lidar"', "intrinsics = 1\nextrinsics = 2\ncolour = 3",
    "intrinsics = 1\nextrinsics = 2",
])  # fmt: skip
def test_damaged_toml(tmp_path, text):
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=path.name):
        Calibration.from_toml(path)


@pytest.mark.parametrize(
    "content", [None, b"R: 1 2 3", b"T: 1 2 3", b"R: a", b"R: nan" + b" 0" * 8, b"\xff"]
)
def test_damaged_kitti(raw, content):
    path = raw / "calib_velo_to_cam.txt"
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=path.name):
        Calibration.from_kitti(raw)


def test_what_is_no_calibration():
    for intrinsics, matrix in ((np.diag([-1.0, 1, 1]), np.eye(4)), (K, extrinsics().T.copy())):
        with pytest.raises(InputError, match=r"trinsics"):
            Calibration(intrinsics, matrix)


@pytest.mark.parametrize("text", ["image_width: 640\ncamera_matrix:\n", "", "1 0 0 0\n0 1 0 0"])
def test_a_file_of_another_tool_is_answered_with_toml_to_fill_in(tmp_path, text):
    path, toml = tmp_path / "camera.yaml", tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(
        InputError, match=r"camera\.yaml is neither .*docs/recordings\.md"
    ) as caught:
        Calibration.from_file(path)
    toml.write_text(str(caught.value).split(":\n", 1)[1])
    assert Calibration.from_file(toml).size == (375, 1242)


KITTI = np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]])


@pytest.mark.parametrize(("intrinsics", "size", "said"), [
    (KITTI, (375, 1242), False),
    (KITTI, (352, 1216), True),
    (KITTI, (188, 621), True),
    (KITTI - [[0, 0, 13], [0, 0, 23], [0, 0, 0]], (352, 1216), False),
    (K, (352, 1216), False),
])  # fmt: skip
def test_images_of_another_size_than_kittis_are_said(tmp_path, intrinsics, size, said):
    """Whatever file holds its intrinsics."""
    rows = np.hstack([intrinsics, np.zeros((3, 1))])
    kitti = {"P2": rows, "R0_rect": np.eye(3), "Tr_velo_to_cam": np.eye(4)[:3]}
    lines = (f"{name}: {' '.join(map(str, matrix.ravel()))}\n" for name, matrix in kitti.items())
    (tmp_path / "calib.txt").write_text("".join(lines))
    toml = f'intrinsics = {intrinsics.tolist()}\npoints_in = "camera"\n'
    (tmp_path / "calib.toml").write_text(toml)
    for name in ("calib.txt", "calib.toml"):
        messages = []
        with collect_assumptions(messages):
            Calibration.from_file(tmp_path / name).project(np.zeros((0, 3), np.float32), size)
        assert len(messages) == said
        assert all(
            "although KITTI's images with these intrinsics have (375, 1242)" in m for m in messages
        )
