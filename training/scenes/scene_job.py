"""One scene, from its seed to its folder: the unit of work of a process.

Folders have the layout of Virtual KITTI 2 (Cabon et al. 2020).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import OutputError
from runtime.drawing.encode import encode_jpeg, encode_png
from runtime.files.own_folder import atomic_folder
from training.scenes.arrays import Floats
from training.scenes.layout.street import build_street
from training.scenes.names import CameraName, SceneClass, StreetKind, Variant
from training.scenes.rendering.camera import make_camera
from training.scenes.rendering.lidar_scan import draw_mount
from training.scenes.rendering.render import RenderedFrame, render_frame
from training.scenes.rendering.weather import draw_weather

_JPEG_QUALITY, _SKY = 92, 65535
_EXTRINSIC = "r1,1 r1,2 r1,3 t1 r2,1 r2,2 r2,3 t2 r3,1 r3,2 r3,3 t3 0 0 0 1"

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


def write_variant(out: Path, frames: Iterable[RenderedFrame], *, overwrite: bool = False) -> Path:
    """Write the frames of one variant of a scene; the folder appears when it is complete.

    It has frames/{rgb,depth,classSegmentation}/Camera_0, colors.txt, intrinsic.txt and
    extrinsic.txt. Depth is uint16 in centimetres, with 65535 for the sky; extrinsics map world to
    camera. In addition to that layout, frames/lidar/Camera_0/lidar_<number>.bin has the LiDAR's
    returns in KITTI's format (float32 x, y, z [m], reflectance, ring after ring), and calib.txt has
    the matrix Tr_velo_to_cam (3 x 4) from the LiDAR to the camera.

    Args:
        out: folder of the variant, <root>/<scene>/<variant>.
        frames: the rendered frames in order.
        overwrite: replace an older variant; a folder with any other file is never replaced.

    Returns:
        The folder `out`.

    Raises:
        OutputError: if the folder exists and may not be replaced, or cannot be written.
    """
    if out.exists() and not overwrite:
        advice = "choose another folder or seed, or give --overwrite"
        raise OutputError(f"{out} exists already: {advice}")
    with atomic_folder(out, overwrite=overwrite) as temporary:
        kinds = ("rgb", "depth", "classSegmentation", "lidar")
        rgb, depth, classes, lidar = (temporary / "frames" / kind / "Camera_0" for kind in kinds)
        for folder in (rgb, depth, classes, lidar):
            folder.mkdir(parents=True)
        colors = ["Category r g b"]
        colors += [" ".join(map(str, (item.category, *item.color))) for item in SceneClass]
        palette = np.array([item.color for item in SceneClass], np.uint8)
        intrinsic = ["frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]"]
        extrinsic = [f"frame cameraID {_EXTRINSIC}"]
        texts = {"colors": colors, "intrinsic": intrinsic, "extrinsic": extrinsic}
        for number, frame in enumerate(frames):
            name = f"{number:05d}"
            _write_image(rgb / f"rgb_{name}.jpg", frame.rgb)
            centimetres = np.clip(np.rint(frame.depth * 100.0), 1, _SKY - 1).astype(np.uint16)
            centimetres[frame.depth <= 0] = _SKY
            _write_image(depth / f"depth_{name}.png", centimetres)
            _write_image(classes / f"classgt_{name}.png", palette[frame.label])
            scan, k = frame.scan, frame.intrinsics
            scan.points.astype("<f4").tofile(lidar / f"lidar_{name}.bin")
            intrinsic.append(f"{number} 0 {k[0, 0]:.6g} {k[1, 1]:.6g} {k[0, 2]:.6g} {k[1, 2]:.6g}")
            extrinsic.append(f"{number} 0 {_numbers(frame.world_to_camera)}")
            texts["calib"] = [f"Tr_velo_to_cam: {_numbers(scan.to_camera[:3])}"]
        for file, lines in texts.items():
            (temporary / f"{file}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return out


def _numbers(matrix: Floats) -> str:
    return " ".join(f"{value:.9g}" for value in matrix.ravel())


def _write_image(path: Path, image: NDArray[Any]) -> None:
    """Encode and then write; OpenCV's own writing only returns False if the disk is full."""
    pixels = np.ascontiguousarray(image[..., ::-1] if image.ndim == 3 else image)
    is_jpeg = path.suffix == ".jpg"
    path.write_bytes(encode_jpeg(pixels, quality=_JPEG_QUALITY) if is_jpeg else encode_png(pixels))
