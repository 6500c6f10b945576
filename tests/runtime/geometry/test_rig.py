from pathlib import Path

import numpy as np
import pytest

from runtime import Calibration, Rig
from runtime.base.errors import InputError

CALIBRATION = Calibration(np.eye(3), np.eye(4))


@pytest.mark.parametrize("values", [
    {"max_skew_ms": -1}, {"max_skew_ms": float("nan")}, {"max_skew_ms": None},
    {"reuse_depth_ms": "x"}, {"reuse_depth_ms": 1e7}, {"calibration": 5}, {"scan_stamp": "first"},
    {"pose_frame": "wheel"}, {"pose_frame": 3},
], ids=str)  # fmt: skip
def test_values_out_of_range_are_refused(values):
    with pytest.raises(InputError, match=next(iter(values))):
        Rig(**values)


def test_a_calibration_is_itself_or_read_from_its_file(tmp_path):
    assert Rig().read_calibration() is None
    assert Rig(calibration=CALIBRATION).read_calibration() is CALIBRATION
    path = tmp_path / "car.toml"
    path.write_text('intrinsics = [[9, 0, 4], [0, 9, 4], [0, 0, 1]]\npoints_in = "camera"\n')
    for given in (path, str(path)):
        assert Rig(calibration=given).read_calibration().focal_length_px == 9


def test_what_was_given_is_known():
    assert Rig().given == ()
    rig = Rig(calibration=Path("car.toml"), scan_stamp="end", reuse_depth_ms=0)
    assert rig.given == ("calibration", "scan_stamp", "reuse_depth_ms")
    assert (Rig().max_depth_age_ms, rig.max_depth_age_ms) == (150, 0)
