"""Scenes rendered on the fly are those that would be written, and nothing is written."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from runtime.errors import DatasetError
from runtime.projection import project_points
from training.datasets.rendered_scenes import RenderedOnTheFlyRecipe, RenderedScenes
from training.datasets.virtual_kitti import VirtualKitti
from training.loading.open_dataset import open_dataset
from training.scenes import scene_job
from training.scenes.classes import CLASS_TABLE
from training.scenes.rendering.render import RenderedFrame
from training.scenes.scene_job import SceneJob, render_frames
from training.scenes.vkitti_writer import write_variant

SIZE = (48, 96)


def test_a_frame_on_the_fly_is_the_frame_on_disk(tmp_path):
    job = SceneJob(tmp_path, 3, ("fog",), frames=1, step_s=1.0, camera="kitti", size=SIZE)
    write_variant(tmp_path, job.name, "fog", render_frames(job, "fog"))
    written = VirtualKitti(tmp_path)[0]
    sample = RenderedScenes(scenes=1, frames=2, seed=3, size=SIZE, variants=["fog"])[0]
    assert sample.name == written.name == "Scene03/fog/00000"
    np.testing.assert_array_equal(sample.semantic, written.semantic)
    np.testing.assert_array_equal(sample.depth > 0, written.depth > 0)
    np.testing.assert_allclose(sample.depth, written.depth, atol=0.00501)  # whole centimetres
    np.testing.assert_allclose(sample.intrinsics, written.intrinsics, rtol=1e-5)
    assert sample.sparse_depth is None
    _, jpeg = cv2.imencode(".jpg", sample.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    np.testing.assert_array_equal(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB), written.rgb)
    assert len(np.unique(sample.semantic)) > 3
    assert [path.name for path in tmp_path.iterdir()] == ["Scene03"]


def test_the_scans_that_were_rendered_are_the_input(tmp_path):
    job = SceneJob(tmp_path, 3, ("fog",), frames=1, step_s=1.0, camera="kitti", size=SIZE)
    (frame,) = render_frames(job, "fog")
    folder = write_variant(tmp_path, job.name, "fog", [frame])
    (sample,) = [VirtualKitti(tmp_path, scans=True)[0]]
    expected = project_points(
        frame.scan.points, frame.intrinsics, frame.scan.to_camera, sample.size
    )
    np.testing.assert_allclose(sample.sparse_depth, expected, atol=1e-3)
    assert np.count_nonzero(expected) > 300
    assert ((sample.scan_line >= 0) == (sample.sparse_depth > 0)).all()
    np.testing.assert_array_equal(sample.depth, VirtualKitti(tmp_path)[0].depth)
    (folder / "frames/lidar/Camera_0/lidar_00000.bin").unlink()
    with pytest.raises(DatasetError, match=r"lidar_00000\.bin"):
        VirtualKitti(tmp_path, scans=True)


@dataclass
class FakeScene:
    """A scene without a ray caster: a row a class, the depth says which frame it is."""

    job: SceneJob
    variant: str

    def render(self, number):
        label = np.repeat(np.arange(len(CLASS_TABLE), dtype=np.uint8)[:, None], 4, axis=1)
        depth = np.full(label.shape, 1.0 + number, np.float32)
        rgb = np.zeros((*label.shape, 3), np.uint8)
        return RenderedFrame(rgb, depth, label, np.eye(4), np.eye(3, dtype=np.float32))


@pytest.fixture
def opened(monkeypatch):
    """Jobs whose scenes were opened, in order."""
    jobs = []

    def open_scene(job, variant):
        jobs.append(job)
        return FakeScene(job, variant)

    monkeypatch.setattr(scene_job, "open_scene", open_scene)
    return jobs


def test_scenes_take_turns_through_the_variants(opened):
    source = RenderedScenes(scenes=3, frames=2, seed=7, size=SIZE, variants=["fog", "rain"])
    assert len(source) == 6
    assert [source[index].name for index in range(6)] == [
        *("Scene07/fog/00000", "Scene07/fog/00001"),
        *("Scene08/rain/00000", "Scene08/rain/00001"),
        *("Scene09/fog/00000", "Scene09/fog/00001"),
    ]
    assert source[3].depth[0, 0] == 2.0
    assert [job.seed for job in opened] == [7, 8, 9, 8]  # a street is built once for its frames
    assert {job.size for job in opened} == {SIZE}


def test_class_ids_are_those_of_the_table_asked_for(opened):
    expected = {  # of Sky, Terrain, ..., Cyclist
        "camvid": [0, 5, 5, 5, 1, 3, 7, 6, 6, 2, 255, 8, 8, 8, 4, 7, 9, 10],
        "cityscapes": [10, 9, 8, 8, 2, 0, 255, 7, 6, 5, 255, 14, 13, 13, 1, 4, 11, 255],
        "virtual_kitti": [1, 0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 255, 255, 255, 255],
    }
    for classes, ids in expected.items():
        sample = RenderedScenes(scenes=1, classes=classes)[0]
        assert sample.semantic[:, 2].tolist() == ids
        assert sample.intrinsics.dtype == np.float64


def test_recipe_says_scenes_frames_and_variants(opened):
    recipe = RenderedOnTheFlyRecipe(
        num_scenes=2,
        frames_per_scene=3,
        scene_seed=20,
        variants=("rain", "fog"),
        size=(36, 40),
    )
    source = open_dataset(recipe, [], classes="camvid")
    assert len(source) == 6
    # Variants come in the renderer's order, whatever the recipe's.
    assert [source[0].name, source[5].name] == ["Scene20/fog/00000", "Scene21/rain/00002"]
    assert opened[0].size == (36, 40)
    with pytest.raises(ValueError, match="should be 'clone', 'morning'"):
        RenderedOnTheFlyRecipe(variants=("snow",))


def test_more_frames_than_the_street_has_room_for():
    assert len(RenderedScenes(scenes=1, frames=17)) == 17
    with pytest.raises(DatasetError, match="18 frames every 1 s: a street lasts 16 s"):
        RenderedScenes(scenes=1, frames=18)
    assert len(RenderedScenes(scenes=1, frames=18, step_s=0.5)) == 18
