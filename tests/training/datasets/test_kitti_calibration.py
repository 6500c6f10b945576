"""KITTI's calibration and scan files: what is damaged is named."""

import pytest

from runtime.errors import DatasetError
from training.datasets.kitti_calibration import read_calibration, read_points


def test_damaged_calibration_and_scan_are_named(tmp_path):
    calibration = tmp_path / "calib.txt"
    calibration.write_text("P_rect_02: 1 2 3\n")
    with pytest.raises(DatasetError, match="'P_rect_02' has 3 numbers, expected 12"):
        read_calibration(calibration)
    calibration.write_text("S_rect_02: 8 6\n")
    with pytest.raises(DatasetError, match="no line 'P_rect_02:'"):
        read_calibration(calibration)
    with pytest.raises(DatasetError, match="cannot read the calibration"):
        read_calibration(tmp_path / "missing.txt")
    scan = tmp_path / "scan.bin"
    scan.write_bytes(b"0" * 30)
    with pytest.raises(DatasetError, match="30 bytes, expected a multiple of 16"):
        read_points(scan)


@pytest.mark.parametrize("projection", ["0 0 8 0 0 9 4 0 0 0 1 0", "9 0 8 0 0 9 4 0 0 0 0 1"])
def test_a_projection_of_no_camera_is_refused(tmp_path, projection):
    calibration = tmp_path / "calib.txt"
    calibration.write_text(
        f"S_rect_02: 16 8\nP_rect_02: {projection}\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
        "velo_to_cam_R: 0 -1 0 0 0 -1 1 0 0\nvelo_to_cam_T: 0 0 0\n"
    )
    with pytest.raises(DatasetError, match="positive focal lengths"):
        read_calibration(calibration)
    calibration.write_text(calibration.read_text().replace(projection, "nan " * 12))
    with pytest.raises(DatasetError, match="'P_rect_02' holds NaN"):
        read_calibration(calibration)
