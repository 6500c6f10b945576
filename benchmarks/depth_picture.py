"""One frame's depth by several models below one another, coloured alike: before and after.

    python benchmarks/depth_picture.py before.onnx ssdnet-lite --out docs/depth.jpg \
        [--frame 0] [--rgb FILE --depth FILE] [--crop TOP LEFT HEIGHT WIDTH] [--zoom 2]

Models are ONNX files, or bundled ones by name. The picture is the image, the depth that was fed,
the depth of each model with its name, and what the colours mean: those of ssdnet-run's overlay.
Where a model's class is sky there is no depth. The frame is one of the bundled stream, or any two
files (depth as a 16-bit PNG).
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import Predictor
from runtime.drawing.overlay import Overlay
from runtime.drawing.picture_text import write_text
from runtime.errors import InputError, SSDNetError
from runtime.io.atomic_write import atomic_write
from runtime.io.images import KITTI_DEPTH_SCALE, read_rgb, read_sparse_depth
from runtime.network_size import parse_network_size
from runtime.sources.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.sources.frames import Frame

Picture = NDArray[np.uint8]
#: (top, left, height, width) in pixels of the frame.
Crop = tuple[int, int, int, int]

_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 92)


def main() -> None:
    """Predict, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", help="ONNX files or bundled models")
    parser.add_argument("--titles", nargs="+", help="instead of the models' names")
    parser.add_argument("--out", type=Path, required=True, help="a .jpg or .png")
    parser.add_argument("--frame", type=int, default=0, help="which of the bundled stream")
    parser.add_argument("--rgb", type=Path, help="picture of another frame")
    parser.add_argument("--depth", type=Path, help="its sparse depth")
    parser.add_argument("--depth-scale", type=float, default=KITTI_DEPTH_SCALE)
    parser.add_argument("--focal-length", type=float, help="of the frame of --rgb [px]")
    parser.add_argument("--size", default="frame", help="frame, auto or rows, as ssdnet-run --size")
    parser.add_argument("--crop", type=int, nargs=4, metavar=("TOP", "LEFT", "HEIGHT", "WIDTH"))
    parser.add_argument("--zoom", type=int, default=1, help="whole number")
    parser.add_argument("--return-px", type=int, default=2, help="side of a return's square")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    if (arguments.rgb is None) != (arguments.depth is None):
        parser.error("give both --rgb and --depth, or neither")
    titles = arguments.titles or [Path(model).stem for model in arguments.models]
    if len(titles) != len(arguments.models):
        parser.error(f"{len(titles)} --titles for {len(arguments.models)} models")
    if arguments.out.suffix not in (".jpg", ".png"):
        parser.error(f"--out {arguments.out}: give it the ending .jpg or .png")
    try:
        picture = draw(find_frame(arguments), titles, arguments)
        write(arguments.out, picture)
    except SSDNetError as error:
        raise SystemExit(f"error: {error}") from error
    print(f"{arguments.out}: {picture.shape[1]} x {picture.shape[0]}")


def find_frame(arguments: argparse.Namespace) -> Frame:
    """Read the frame that was asked for. Raises InputError."""
    if arguments.rgb is not None:
        depth = read_sparse_depth(arguments.depth, depth_scale=arguments.depth_scale)
        return Frame(read_rgb(arguments.rgb), depth)
    frames = bundled_frames()
    if not 0 <= arguments.frame < len(frames):
        raise InputError(f"--frame {arguments.frame}: the stream has 0..{len(frames) - 1}")
    return frames[arguments.frame]


def draw(frame: Frame, titles: Sequence[str], arguments: argparse.Namespace) -> Picture:
    """Draw the panels, blue first."""

    focal_length_px = arguments.focal_length if arguments.rgb else BUNDLED_FOCAL_LENGTH_PX
    answers = []
    for model in arguments.models:
        with Predictor(
            model, size=parse_network_size(arguments.size), threads=arguments.threads, warmup=0
        ) as predictor:
            prediction = predictor.predict(
                frame.rgb, frame.sparse_depth, focal_length_px=focal_length_px
            )
            if prediction.depth is None:
                raise InputError(f"{model} answers no depth")
            answers.append((predictor.contract, prediction))
    max_depth_m = max(contract.max_depth_m for contract, _ in answers)
    panels = [
        ("image", frame.rgb[..., ::-1]),
        ("sparse depth", paint_returns(frame, Overlay((), max_depth_m), arguments.return_px)),
    ]
    for title, (contract, prediction) in zip(titles, answers, strict=True):
        overlay = Overlay(contract.classes, max_depth_m)
        panels.append((title, overlay.paint_depth(prediction.depth, prediction.semantic)))
    stack = []
    for title, panel in panels:
        part = cut_out(panel, arguments.crop, arguments.zoom, smooth=title == "image")
        write_text(part, title, (6, 16))
        stack.append(part)
    bar = Overlay((), max_depth_m).draw_depth_bar(stack[0].shape[1])
    return np.vstack([*stack, bar])


def paint_returns(frame: Frame, overlay: Overlay, side_px: int) -> Picture:
    """The returns on black, each a square, since single pixels are hardly seen; near ones win."""
    beyond = np.float32(np.finfo(np.float32).max)
    nearest = cv2.erode(
        np.where(frame.sparse_depth > 0, frame.sparse_depth, beyond),
        np.ones((side_px, side_px), np.uint8),
    )
    panel = overlay.paint_depth(nearest)
    panel[nearest == beyond] = 0
    return panel


def cut_out(panel: Picture, crop: Crop | None, zoom: int, *, smooth: bool) -> Picture:
    """Cut a part and magnify it; colours that stand for numbers are not mixed."""
    if crop is not None:
        top, left, height, width = crop
        panel = panel[top : top + height, left : left + width]
        if panel.shape[:2] != (height, width):
            raise InputError(f"--crop {top} {left} {height} {width}: reaches beyond the frame")
    way = cv2.INTER_CUBIC if smooth else cv2.INTER_NEAREST
    return cv2.resize(np.ascontiguousarray(panel), None, fx=zoom, fy=zoom, interpolation=way)


def write(path: Path, picture: Picture) -> None:
    """Write the picture, whole or not at all."""
    ok, content = cv2.imencode(path.suffix, picture, _JPEG if path.suffix == ".jpg" else ())
    if not ok:
        raise InputError(f"{path}: a picture of {picture.shape[:2]} cannot be encoded")
    atomic_write(path, content.tobytes())


if __name__ == "__main__":
    main()
