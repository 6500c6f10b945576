"""What the engine adds to the session alone, and what reading and writing files adds to both.

    python benchmarks/latency.py [--sizes 375x1242 ...] [--threads 2] [--rounds 7]

For each model and size the same frames are run interleaved, so that a disturbance affects all ways
alike: by the ONNX Runtime session alone, by `Predictor.predict`, and by the pipeline of
`ssdnet-run` (files in, every kind of picture out), once from JPEG and once from PNG images, which
take four times as long to decode. The depth maps are PNGs either way. Quote the ratios.

"busy" is how many cores the process keeps busy on average: a pipeline that keeps all of them busy
can only become faster by doing less.
"""

import argparse
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from export.exporter import export_checkpoint
from models import create_model, save_checkpoint
from runtime import Predictor
from runtime.bundled_models import find_model, list_bundled_models
from runtime.engine_facts import cpu_name
from runtime.resize import move_returns
from runtime.run.outputs.frame_writer import FrameWriter
from runtime.run.pipeline import run_stream
from runtime.run.process import dedicate_process
from runtime.run.run_folder import KINDS
from runtime.sources.bundled_stream import bundled_frames
from runtime.sources.folders import FolderSource

SIZES = ("125x414", "375x1242", "512x1024")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", default=["ssdnet-lite", "ssdnet"])
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), help="HEIGHTxWIDTH")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7, help="runs of each way")
    parser.add_argument("--seconds", type=float, default=2.0, help="length of one run")
    parser.add_argument("--scratch", type=Path, help="folder to write to; the system's otherwise")
    arguments = parser.parse_args()

    print(
        f"{cpu_name()}, {arguments.threads} threads, onnxruntime {version('onnxruntime')}, "
        f"Python {platform.python_version()}; medians of {arguments.rounds} interleaved runs\n"
    )
    print(
        "| model | size | frames a run | session ms | predict ms | busy | ratio | "
        "stream from JPEG ms a frame | busy | throughput against predict | "
        "from PNG ms a frame | busy | throughput |"
    )
    print("|" + "---|" * 13)
    dedicate_process()
    with tempfile.TemporaryDirectory(dir=arguments.scratch) as scratch:
        for name in arguments.models:
            model = _model(name, Path(scratch))
            for size in arguments.sizes:
                height, width = (int(part) for part in size.split("x"))
                row = measure(
                    model,
                    (height, width),
                    Path(scratch) / f"{name}-{size}",
                    threads=arguments.threads,
                    rounds=arguments.rounds,
                    seconds=arguments.seconds,
                )
                print(
                    f"| {name} | {size} | {row['frames']} | {row['session_ms']:.2f} | "
                    f"{row['predict_ms']:.2f} | {row['predict_busy']:.2f} | "
                    f"{row['predict_ratio']:.3f} | "
                    f"{row['jpg_ms']:.2f} | {row['jpg_busy']:.2f} | {row['jpg_throughput']:.2f} | "
                    f"{row['png_ms']:.2f} | {row['png_busy']:.2f} | {row['png_throughput']:.2f} |",
                    flush=True,
                )


def measure(
    model: Path,
    size: tuple[int, int],
    scratch: Path,
    *,
    threads: int,
    rounds: int,
    seconds: float,
) -> dict[str, float]:
    """Time one model at one size; every figure is a median over rounds."""
    with Predictor(model, size="frame", threads=threads) as predictor:
        sources = {suffix: _resized(scratch, size, suffix) for suffix in (".jpg", ".png")}
        frames = [sources[".png"].read(listed) for listed in sources[".png"].list_frames()]
        session = predictor._session  # the same session, so that only the engine differs
        feeds = [
            {"rgb": frame.rgb[None], "sparse_depth": frame.sparse_depth[None]} for frame in frames
        ]
        predictor.predict(frames[0].rgb, frames[0].sparse_depth)
        one, _ = _timed(lambda: predictor.predict(frames[0].rgb, frames[0].sparse_depth))
        count = max(4, min(40, round(seconds / one)))
        order = [index % len(frames) for index in range(count)]

        def run_session() -> tuple[float, float]:
            return _timed(lambda: [session.run(predictor.heads, feeds[index]) for index in order])

        def run_predict() -> tuple[float, float]:
            return _timed(
                lambda: [
                    predictor.predict(frames[index].rgb, frames[index].sparse_depth)
                    for index in order
                ]
            )

        def run_whole_stream(suffix: str) -> tuple[float, float]:
            # A new folder, and nothing removed in between: ext4 skips the inodes of files removed
            # in the last seconds one by one, up to 0.6 ms a new file.
            listed = sources[suffix].list_frames()
            named = [
                replace(listed[index], name=f"{number:06d}") for number, index in enumerate(order)
            ]
            out = Path(tempfile.mkdtemp(dir=scratch))
            writer = FrameWriter(out, predictor.contract, kinds=KINDS)
            return _timed(
                lambda: run_stream(predictor, named, read=sources[suffix].read, write=writer.write)
            )

        ways = (
            run_session,
            run_predict,
            lambda: run_whole_stream(".jpg"),
            lambda: run_whole_stream(".png"),
        )
        for way in ways:  # to warm up
            way()
        timed = np.array([[way() for way in ways] for _ in range(rounds)])  # (rounds, ways, 2)
    times = timed[..., 0] / count * 1e3
    session_ms, predict_ms, jpg_ms, png_ms = (float(np.median(column)) for column in times.T)
    busy = np.median(timed[..., 1] / timed[..., 0], axis=0)
    return {
        "frames": count,
        "session_ms": session_ms,
        "predict_ms": predict_ms,
        "predict_busy": float(busy[1]),
        "predict_ratio": statistics.median(times[:, 1] / times[:, 0]),
        "jpg_ms": jpg_ms,
        "jpg_busy": float(busy[2]),
        "jpg_throughput": statistics.median(times[:, 1] / times[:, 2]),
        "png_ms": png_ms,
        "png_busy": float(busy[3]),
        "png_throughput": statistics.median(times[:, 1] / times[:, 3]),
    }


def _timed(call: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor time of a call, the latter of all threads, in seconds."""
    started, worked = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - started, time.process_time() - worked


def _model(name: str, scratch: Path) -> Path:
    """Return a bundled model, or an export of random weights, which run as fast as trained."""
    if name in list_bundled_models():
        return find_model(name)
    checkpoint, onnx = scratch / f"{name}.pt", scratch / f"{name}.onnx"
    save_checkpoint(checkpoint, create_model(name).eval())
    export_checkpoint(checkpoint, onnx)
    return onnx


def _resized(folder: Path, size: tuple[int, int], suffix: str) -> FolderSource:
    """Write the first frames of the bundled stream at another size."""
    folder = folder / suffix[1:]
    for number, frame in enumerate(bundled_frames()[:5]):
        bgr = cv2.resize(frame.rgb[..., ::-1], size[::-1], interpolation=cv2.INTER_CUBIC)
        _write(folder / "rgb" / f"{number}{suffix}", bgr)
        units = (move_returns(frame.sparse_depth, size) * 256).astype(np.uint16)
        _write(folder / "depth" / f"{number}.png", units)
    return FolderSource(folder / "rgb", depth=folder / "depth")


def _write(path: Path, image: NDArray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # KITTI's depth maps are packed without a filter.
    depth = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_COMPRESSION, 6)
    cv2.imwrite(str(path), image, depth if image.ndim == 2 else ())


if __name__ == "__main__":
    main()
