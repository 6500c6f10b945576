"""Numbers of an unlikely unit are said, whoever reads them; numbers of rare rigs are not."""

import numpy as np
import pytest

from car_poses import pose
from runtime import Calibration, Predictor
from runtime.geometry.assumptions import AssumptionWarning
from runtime.geometry.units import check_field_of_view

K = np.array([[700.0, 0, 320], [0, 710, 120], [0, 0, 1]])


@pytest.mark.parametrize("focal", [18, 4.2, 111])
def test_a_focal_length_in_millimetres_is_said(focal):
    with pytest.warns(AssumptionWarning, match=f"focal length of {focal:g} px.*degrees"):
        check_field_of_view(focal, 832)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("focal", "width"), [(112, 832), (386, 1280), (18, 64), (1280 / 6.28, 1280)]
)
def test_wide_lenses_and_panoramas_are_possible(focal, width):
    check_field_of_view(focal, width)


def test_every_way_to_a_predictor_says_it_but_not_its_warm_up(make_frame, recwarn):
    rgb, depth = make_frame(64, 96)
    with Predictor("ssdnet-nano", threads=1, focal_length_px=60) as predictor:  # warms up at 832 px
        predictor.predict(rgb, depth)
        assert not [each for each in recwarn if each.category is AssumptionWarning]
        for ask in (
            lambda: predictor.predict(rgb, depth, focal_length_px=4.2),
            lambda: predictor.predict_batch([(rgb, depth)], focal_lengths_px=[4.2]),
            lambda: predictor.camera_scale((64, 96), focal_length_px=4.2),
        ):
            with pytest.warns(AssumptionWarning, match="4.2 px"):
                ask()


@pytest.mark.parametrize("centre", [(1241, 120), (320, 241), (-1, 120)])
def test_a_principal_point_outside_the_images_is_said(centre):
    """Whether the size is stated or that of an image; images that were cut may have it there."""
    matrix = K.copy()
    matrix[:2, 2] = centre
    with pytest.warns(AssumptionWarning, match=f"at cx {centre[0]} and cy {centre[1]}: check"):
        Calibration(matrix, np.eye(4), (240, 640))
    with pytest.warns(AssumptionWarning, match="outside the images of 640 x 240 px"):
        Calibration(matrix, np.eye(4)).project(np.zeros((0, 3), np.float32), (240, 640))


@pytest.mark.parametrize("shift", [(-0.4, -7.6, -27.0), (4, -76, -270), (3.2, 0, 0)])
def test_a_mount_in_centimetres_is_said(shift):
    with pytest.warns(AssumptionWarning, match="m from the camera: translations are metres"):
        Calibration(K, pose(shift))
    with pytest.warns(AssumptionWarning, match="m from the body"):
        Calibration(K, np.eye(4), body_from_lidar=pose((95, 0, 173)))


@pytest.mark.filterwarnings("error")
def test_mounts_of_trucks_are_possible():
    Calibration(K, pose((1.2, -2, 1.5)), body_from_lidar=pose((6, 0, 3.2)))
