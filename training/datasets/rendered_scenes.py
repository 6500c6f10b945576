"""Rendered scenes on the fly: nothing is written, a frame is rendered when it is asked for."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from runtime.errors import DatasetError
from training.datasets.class_mapping import id_lookup
from training.datasets.sample import Sample
from training.scenes.classes import CLASS_TABLE
from training.scenes.rendering.camera import CameraName
from training.scenes.rendering.weather import VARIANTS, Variant
from training.scenes.scene_job import LONGEST_S, Scene, SceneJob, open_scene


class RenderedScenes:
    """``scenes`` streets of ``frames`` frames each, as `ssdnet-render` would write them.

    The scenes have the seeds ``seed`` ... ``seed + scenes - 1`` and take turns through
    ``variants``; ``size`` is (height, width). A frame costs about a second of processor time and
    more, so a mixture of them wants many workers, or a cache. Equal arguments give equal frames.
    ``classes`` is the class table that labels are told in. Raises DatasetError for more frames than
    a street has room for.
    """

    def __init__(
        self,
        *,
        scenes: int,
        frames: int = 4,
        seed: int = 0,
        size: tuple[int, int] = (375, 1242),
        camera: CameraName = "kitti",
        step_s: float = 1.0,
        variants: Sequence[Variant] = VARIANTS,
        classes: str = "camvid",
    ) -> None:
        if (frames - 1) * step_s > LONGEST_S:
            raise DatasetError(
                f"{frames} frames every {step_s:g} s: a street lasts {LONGEST_S:.0f} s. Ask for "
                "more scenes of fewer frames."
            )
        self._jobs = [
            SceneJob(
                root=Path(),  # nothing is written
                seed=seed + index,
                variants=(variants[index % len(variants)],),
                frames=frames,
                step_s=step_s,
                camera=camera,
                size=size,
            )
            for index in range(scenes)
        ]
        self._frames = frames
        self._lookup = id_lookup("virtual_kitti", classes, [name for name, _ in CLASS_TABLE])
        self._open = lru_cache(maxsize=1)(self._open_scene)

    def __len__(self) -> int:
        return len(self._jobs) * self._frames

    def __getitem__(self, index: int) -> Sample:
        scene_index, number = divmod(index, self._frames)
        scene = self._open(scene_index)
        frame = scene.render(number)
        return Sample(
            rgb=frame.rgb,
            depth=frame.depth,
            semantic=self._lookup[frame.label],
            intrinsics=np.asarray(frame.intrinsics, dtype=np.float64),
            name=f"{scene.job.name}/{scene.variant}/{number:05d}",
        )

    def _open_scene(self, index: int) -> Scene:
        job = self._jobs[index]
        return open_scene(job, job.variants[0])
