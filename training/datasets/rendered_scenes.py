"""Scenes rendered on the fly: nothing is written, a frame is rendered when it is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.sample import Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT, Count, Seed
from training.scenes.classes import CLASS_TABLE
from training.scenes.rendering.camera import CameraName
from training.scenes.rendering.weather import VARIANTS, Variant

if TYPE_CHECKING:
    from training.scenes.scene_job import Scene


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedOnTheFlyRecipe(SourceRecipe):
    """Options of scenes that are rendered while training, in a recipe."""

    kind: Literal["rendered-on-the-fly"] = "rendered-on-the-fly"
    #: No folder; a name for the scores.
    path: str = ""
    #: All by default.
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)] = VARIANTS
    num_scenes: Count = 100
    frames_per_scene: Count = 4
    #: Of the first scene.
    scene_seed: Seed = 0

    on_disk: ClassVar[bool] = False

    def open(self, folder: Path, classes: ClassTable) -> RenderedScenes:
        """See `SourceRecipe.open`; no folder is read."""
        return RenderedScenes(
            scenes=self.num_scenes,
            frames=self.frames_per_scene,
            seed=self.scene_seed,
            size=self.size or (375, 1242),
            variants=[item for item in VARIANTS if item in self.variants],
            classes=classes,
        )


class RenderedScenes:
    """Streets of several frames each, as `ssdnet-render` would write them.

    Equal arguments give equal frames. Rendering a frame takes much longer than reading one: use
    many workers or a cache.

    Args:
        scenes: number of streets; they have the seeds ``seed`` ... ``seed + scenes - 1``.
        frames: frames of a street.
        seed: of the first street.
        size: (height, width).
        camera: name of the camera.
        step_s: time between frames [s].
        variants: weather and light; the streets use them in turn.
        classes: table of the class ids.

    Raises:
        DatasetError: for more frames than a street has room for.
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
        classes: ClassTable = "camvid",
    ) -> None:
        # Imported here: it needs the ray caster.
        from training.scenes.scene_job import LONGEST_S, SceneJob

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
        self._opened: tuple[int, Scene] | None = None

    def __len__(self) -> int:
        return len(self._jobs) * self._frames

    def __getstate__(self) -> dict[str, Any]:
        """Return what a worker process needs: it opens its own scenes."""
        return {**vars(self), "_opened": None}

    def __getitem__(self, index: int) -> Sample:
        scene_index, number = divmod(index, self._frames)
        scene = self._open_scene(scene_index)
        frame = scene.render(number)
        return Sample(
            rgb=frame.rgb,
            targets={"depth": frame.depth, "semantic": self._lookup[frame.label]},
            intrinsics=np.asarray(frame.intrinsics, dtype=np.float64),
            name=f"{scene.job.name}/{scene.variant}/{number:05d}",
        )

    def _open_scene(self, index: int) -> Scene:
        """The scene, cached until another is read: a street is built once for its frames."""
        from training.scenes.scene_job import open_scene

        if self._opened is None or self._opened[0] != index:
            job = self._jobs[index]
            self._opened = index, open_scene(job, job.variants[0])
        return self._opened[1]
