"""Rendered scenes as they are read: what was rendered."""

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from layouts import open_set
from runtime.base.errors import DatasetError
from runtime.geometry.projection import project_points
from training.datasets.class_mapping import file_ids
from training.scenes.scene_job import SceneClass, SceneJob, Variant, render_frames, run_job

JOB = SceneJob(3, Variant.fog, frames=1, step_s=1.0, size=(48, 96))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The folder of a scene, and its frame as it was given to be written."""
    folder, frames = tmp_path_factory.mktemp("rendered"), []

    def render(job):
        frames.extend(render_frames(job))
        return iter(frames)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("training.scenes.scene_job.render_frames", render)
        run_job(JOB, out=folder, overwrite=False)
    return folder, frames[0]


def test_a_frame_is_read_as_it_was_rendered(scene):
    folder, frame = scene
    written = open_set("rendered", folder)[0]
    assert written.name == "Scene03/fog/00000"
    ids = file_ids("virtual_kitti", "camvid", [item.category for item in SceneClass])
    np.testing.assert_array_equal(np.array([*ids.values()])[frame.label], written.semantic)
    np.testing.assert_array_equal(frame.depth > 0, written.depth > 0)
    np.testing.assert_allclose(frame.depth, written.depth, atol=0.00501)  # whole centimetres
    np.testing.assert_allclose(frame.intrinsics, written.intrinsics, rtol=1e-5)
    assert written.returns is None
    _, jpeg = cv2.imencode(".jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    np.testing.assert_array_equal(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB), written.rgb)
    assert len(np.unique(written.semantic)) > 3
    assert [path.name for path in folder.iterdir()] == ["Scene03"]


def test_the_scans_that_were_rendered_are_the_input(scene):
    folder, frame = scene
    (sample,) = [open_set("rendered", folder, scans=True)[0]]
    expected = project_points(
        frame.scan.points, frame.intrinsics, frame.scan.to_camera, sample.size
    )
    np.testing.assert_allclose(sample.returns, expected, atol=1e-3)
    assert np.count_nonzero(expected) > 300
    assert ((sample.scan_line >= 0) == (sample.returns > 0)).all()
    np.testing.assert_array_equal(sample.depth, open_set("rendered", folder)[0].depth)
    (folder / "Scene03/fog/frames/lidar/Camera_0/lidar_00000.bin").unlink()
    with pytest.raises(DatasetError, match=r"lidar_00000\.bin"):
        open_set("rendered", folder, scans=True)
