"""Rotations that are taken as they are, made exact with a warning, or refused: wherever read."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime import InputError
from runtime.geometry.assumptions import AssumptionWarning
from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import PoseTrack
from runtime.geometry.rigid import nearest_rigid
from runtime.recordings.poses import pose_of

K = np.array([[700.0, 0, 320], [0, 710, 120], [0, 0, 1]])
TURN = Rotation.from_rotvec([0.1, -0.2, 1.4]).as_matrix()
SKEW = np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]])
QUATERNION = Rotation.from_matrix(TURN).as_quat()


def rigid(rotation):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, (0.1, 0.2, 0.3)
    return matrix


def sign_lost():
    turn = TURN.copy()
    turn[0, 1] *= -1
    return turn


def of_toml(folder, matrix):
    rows = f"intrinsics = {K.tolist()}\nextrinsics = {matrix.tolist()}\n"
    (folder / "car.toml").write_text(rows)
    return Calibration.from_file(folder / "car.toml").extrinsics


def of_kitti(folder, matrix):
    p2 = np.hstack([K, np.zeros((3, 1))])
    texts = {"P2": p2, "R0_rect": matrix[:3, :3], "Tr_velo_to_cam": np.eye(4)[:3]}
    lines = [f"{name}: {' '.join(map(repr, m.ravel().tolist()))}\n" for name, m in texts.items()]
    (folder / "calib.txt").write_text("".join(lines))
    return rigid(Calibration.from_file(folder / "calib.txt").extrinsics[:3, :3])


READERS = {
    "array": lambda _, matrix: nearest_rigid("place", matrix),
    "toml": of_toml,
    "kitti": of_kitti,
    "body": lambda _, matrix: Calibration(K, np.eye(4), body_from_lidar=matrix).body_from_lidar,
    "poses": lambda _, matrix: PoseTrack.of([matrix], [0]).at(np.zeros(1, np.int64))[0],
}


FILES = {"toml": "car.toml", "kitti": "calib.txt"}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(("rotation", "outcome"), [
    (TURN, "silent"), (TURN.round(4), "silent"), (TURN.astype(np.float32).astype(float), "silent"),
    (TURN @ (np.eye(3) + 0.005 * SKEW), "nearest"),  # as in DAIR-V2X
    (TURN.round(2), "nearest"), (1.008 * TURN, "nearest"),
    (TURN @ (np.eye(3) + 0.03 * SKEW), "refused"), (1.05 * TURN, "refused"),
    (TURN * [[-1], [1], [1]], "refused"), (sign_lost(), "refused"), (1e200 * TURN, "refused"),
])  # fmt: skip
def test_a_rotation_is_exact_or_nearly_one(tmp_path, reader, rotation, outcome):
    read = READERS[reader]
    if outcome == "refused":
        with pytest.raises(InputError, match="must be rigid") as caught:
            read(tmp_path, rigid(rotation))
        assert "give rows at right angles" in str(caught.value)
        assert reader not in FILES or f"{FILES[reader]}: extrinsics must" in str(caught.value)
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read(tmp_path, rigid(rotation))
    assert [each.category for each in caught] == [AssumptionWarning] * (outcome == "nearest")
    np.testing.assert_allclose(found, rigid(TURN), atol=0.015)
    exact = 2e-3 if outcome == "silent" else 1e-12
    np.testing.assert_allclose(found[:3, :3].T @ found[:3, :3], np.eye(3), atol=exact)


@pytest.mark.parametrize(("length", "outcome"), [
    (1, "silent"), (1.0005, "silent"), (-1, "silent"), (0.99, "nearest"), (1.009, "nearest"),
    (0.97, "refused"), (1.03, "refused"), (0, "refused"), (np.nan, "refused"),
])  # fmt: skip
def test_a_quaternion_is_of_unit_length_or_nearly(length, outcome):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if outcome == "refused":
            with pytest.raises(InputError, match="line 3"):
                pose_of((0.1, 0.2, 0.3), length * QUATERNION, "line 3")
            return
        found = pose_of((0.1, 0.2, 0.3), length * QUATERNION, "line 3")
    assert len(caught) == (outcome == "nearest")
    np.testing.assert_allclose(found, rigid(TURN), atol=1e-3)
