"""Make the two folders of images and sparse depth that `ssdnet-run` reads from a rendered scene.

    python -m training.scenes.bundled_stream_maker SCENE/VARIANT OUT

The bundled stream was made with it.
"""

from pathlib import Path

import cv2
import numpy as np
import typer

from runtime.command.process import reported_errors
from runtime.files.atomic_write import atomic_write
from runtime.recordings.images import KITTI_DEPTH_SCALE
from training.datasets.virtual_kitti import RenderedRecipe
from training.lidar.split import scan_lines


def write_lidar_stream(variant: Path, out: Path) -> int:
    """Write `out/rgb/*.jpg` and `out/depth/*.png`.

    Args:
        variant: `<root>/<scene>/<variant>` in the Virtual KITTI 2 layout. Its images are copied;
            its dense depth is sampled by a simulated LiDAR of 64 lines (uint16, metres x 256, 0 =
            no return).
        out: folder for the two folders.

    Returns:
        The number of frames.

    Raises:
        DatasetError: if a file cannot be read.
        OutputError: if a file cannot be written.
    """
    variant = variant.resolve()
    root, scenes, variants = variant.parent.parent, (variant.parent.name,), (variant.name,)
    recipe = RenderedRecipe(path=str(root), scenes=scenes, variants=variants)
    source = recipe.open(root, "camvid")
    rng = np.random.default_rng(0)
    (out / "rgb").mkdir(parents=True, exist_ok=True)
    (out / "depth").mkdir(exist_ok=True)
    for index in range(len(source)):
        sample = source[index]
        if sample.intrinsics is None:
            raise TypeError("a rendered sample has intrinsics")
        sparse_depth = scan_lines(sample.depth, sample.intrinsics, 64, rng)
        number = sample.name.rsplit("/", 1)[-1]
        picture = variant / "frames" / "rgb" / "Camera_0" / f"rgb_{number}.jpg"
        units = np.rint(sparse_depth * KITTI_DEPTH_SCALE).astype(np.uint16)
        _, png = cv2.imencode(".png", units, (cv2.IMWRITE_PNG_COMPRESSION, 9))
        atomic_write(out / "rgb" / f"{number}.jpg", picture.read_bytes())
        atomic_write(out / "depth" / f"{number}.png", png.tobytes())
    return len(source)


def main(variant: Path, out: Path) -> None:
    """Scan a rendered scene with a LiDAR and write its frames for ssdnet-run."""
    with reported_errors("train"):
        typer.echo(f"{write_lidar_stream(variant, out)} frames in {out}")


if __name__ == "__main__":
    typer.run(main)
