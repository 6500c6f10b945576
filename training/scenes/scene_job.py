"""Rendering and writing one scene: the unit of work of a process."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from training.scenes.layout.street import build_street
from training.scenes.names import CameraName, SceneClass, StreetKind, Variant
from training.scenes.rendering.camera import make_camera
from training.scenes.rendering.lidar_scan import draw_mount
from training.scenes.rendering.render import RenderedFrame, render_frame
from training.scenes.rendering.weather import draw_weather
from training.scenes.vkitti_writer import write_variant

__all__ = ["SceneClass", "SceneJob", "Variant", "render_frames", "run_job"]


@dataclass(frozen=True)
class SceneJob:
    """The parameters of a scene.

    Attributes:
        seed: seed of layout, light, camera and noise.
        variant: light and weather.
        frames: number of frames.
        step_s: seconds between two frames.
        size: (height, width) of KITTI's camera; varied cameras have their own sizes.
        camera: KITTI's camera, or a random one from the seed.
        kind: kind of the street; None: the seed chooses it.
    """

    seed: int
    variant: Variant
    frames: int
    step_s: float
    size: tuple[int, int]
    camera: CameraName = CameraName.kitti
    kind: StreetKind | None = None


def render_frames(job: SceneJob) -> Iterator[RenderedFrame]:
    """Yield the frames of a scene in order; equal jobs give equal frames."""
    seed, varied = job.seed, job.camera == CameraName.varied
    street = build_street(seed, kind=job.kind)
    camera = make_camera(job.camera, job.size, seed)
    mount = draw_mount(camera, np.random.default_rng([seed, 6]), varied=varied)
    weather = draw_weather(job.variant, seed)
    sway = float(np.random.default_rng([seed, 4]).uniform(0, 1000))
    for number in range(job.frames):
        rng = np.random.default_rng([seed, 3, list(Variant).index(job.variant), number])
        time = number * job.step_s
        yield render_frame(street, camera, weather, mount, time=time, sway=sway, rng=rng)


def run_job(
    job: SceneJob, *, out: Path, overwrite: bool, advance: Callable[[], object] = int
) -> int:
    """Render and write a scene below `out`; returns the number of frames.

    `advance` is called after each frame.
    """
    cv2.setNumThreads(1)

    def counted() -> Iterator[RenderedFrame]:
        for frame in render_frames(job):
            yield frame
            advance()

    variant = out / f"Scene{job.seed:02d}" / job.variant
    write_variant(variant, counted(), overwrite=overwrite)
    return job.frames
