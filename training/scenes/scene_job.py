"""Rendering and writing one scene: the unit of work of a process."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from training.scenes.layout.street import Street, build_street
from training.scenes.layout.street_plan import StreetKind
from training.scenes.rendering.camera import CameraName, make_camera
from training.scenes.rendering.lidar_scan import draw_mount
from training.scenes.rendering.render import RenderedFrame, render_frame
from training.scenes.rendering.weather import VARIANTS, Variant, Weather, draw_weather
from training.scenes.vkitti_writer import write_variant

#: Time until the ego car reaches the end of the street [s].
LONGEST_S = 16.0


@dataclass(frozen=True)
class SceneJob:
    """The parameters of a scene.

    seed: of layout, weather, light and noise. step_s: seconds between two frames.
    """

    root: Path
    seed: int
    variants: tuple[Variant, ...]
    frames: int
    step_s: float
    camera: CameraName
    size: tuple[int, int]
    kind: StreetKind | None = None
    overwrite: bool = False

    @property
    def name(self) -> str:
        """Folder name of the scene."""
        return f"Scene{self.seed:02d}"


@dataclass(frozen=True)
class Scene:
    """One variant of a scene, ready to be rendered frame by frame."""

    job: SceneJob
    variant: Variant
    street: Street
    weather: Weather
    sway: float

    def render(self, number: int) -> RenderedFrame:
        """Frame ``number``; equal jobs give equal arrays."""
        key = [self.job.seed, 3, VARIANTS.index(self.variant), number]
        camera = make_camera(self.job.camera, self.job.size, self.job.seed)
        rng = np.random.default_rng([self.job.seed, 6])
        return render_frame(
            self.street,
            camera,
            self.weather,
            time=number * self.job.step_s,
            sway=self.sway,
            rng=np.random.default_rng(key),
            mount=draw_mount(camera, rng, varied=self.job.camera == "varied"),
        )


def open_scene(job: SceneJob, variant: Variant) -> Scene:
    """Build the street of a job, which all of its frames share."""
    # CamVid is from Britain, KITTI from Germany; a few scenes of each have the other side.
    left_hand = (job.seed % 10 != 0) if job.camera == "camvid" else (job.seed % 5 == 0)
    sway = np.random.default_rng([job.seed, 4]).uniform(0, 1000)
    return Scene(
        job,
        variant,
        build_street(job.seed, kind=job.kind, left_hand=left_hand),
        draw_weather(variant, job.seed),
        float(sway),
    )


def render_frames(job: SceneJob, variant: Variant) -> Iterator[RenderedFrame]:
    """Frames of one variant, in order."""
    scene = open_scene(job, variant)
    return (scene.render(number) for number in range(job.frames))


def run_job(job: SceneJob) -> int:
    """Render and write all variants of a scene; returns the number of frames."""
    cv2.setNumThreads(1)
    for variant in job.variants:
        write_variant(
            job.root, job.name, variant, render_frames(job, variant), overwrite=job.overwrite
        )
    return job.frames * len(job.variants)
