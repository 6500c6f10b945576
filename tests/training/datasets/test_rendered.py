"""Rendered scenes as they are read: what was rendered."""

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from runtime.errors import DatasetError
from runtime.projection import project_points
from training.datasets.class_mapping import id_lookup
from training.datasets.virtual_kitti import VirtualKitti
from training.scenes.classes import CLASS_TABLE
from training.scenes.scene_job import SceneJob, render_frames
from training.scenes.vkitti_writer import write_variant

SIZE = (48, 96)


def test_a_frame_is_read_as_it_was_rendered(tmp_path):
    job = SceneJob(tmp_path, 3, ("fog",), frames=1, step_s=1.0, camera="kitti", size=SIZE)
    (frame,) = render_frames(job, "fog")
    folder = write_variant(tmp_path, job.name, "fog", [frame])
    written = VirtualKitti(tmp_path)[0]
    assert written.name == "Scene03/fog/00000"
    lookup = id_lookup("virtual_kitti", "camvid", [name for name, _ in CLASS_TABLE])
    np.testing.assert_array_equal(lookup[frame.label], written.semantic)
    np.testing.assert_array_equal(frame.depth > 0, written.depth > 0)
    np.testing.assert_allclose(frame.depth, written.depth, atol=0.00501)  # whole centimetres
    np.testing.assert_allclose(frame.intrinsics, written.intrinsics, rtol=1e-5)
    assert written.sparse_depth is None
    _, jpeg = cv2.imencode(".jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    np.testing.assert_array_equal(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB), written.rgb)
    assert len(np.unique(written.semantic)) > 3
    assert [path.name for path in tmp_path.iterdir()] == ["Scene03"]
    # Its scan is the input if that is asked for.
    sample = VirtualKitti(tmp_path, scans=True)[0]
    expected = project_points(
        frame.scan.points, frame.intrinsics, frame.scan.to_camera, sample.size
    )
    np.testing.assert_allclose(sample.sparse_depth, expected, atol=1e-3)
    assert np.count_nonzero(expected) > 300
    assert ((sample.scan_line >= 0) == (sample.sparse_depth > 0)).all()
    np.testing.assert_array_equal(sample.depth, written.depth)
    (folder / "frames/lidar/Camera_0/lidar_00000.bin").unlink()
    with pytest.raises(DatasetError, match=r"lidar_00000\.bin"):
        VirtualKitti(tmp_path, scans=True)
