"""Resident memory over many frames, which shows whether the engine leaks.

    python benchmarks/memory.py [--frames 2000] [--threads 2]

Predicts the bundled stream repeatedly, with `Predictor.predict` and with the pipeline of
`ssdnet-run`, and prints the resident size after every tenth of the frames.
"""

import argparse
import tempfile
from pathlib import Path

import psutil

from runtime import Predictor
from runtime.app.run.options import KINDS, RunOptions
from runtime.app.run.outputs.frame_writer import FrameWriter, make_run_folder
from runtime.app.run.outputs.run_context import RunContext
from runtime.app.run.pipeline import dedicate_process, frame_reader, run_stream
from runtime.recordings.bundled_stream import bundled_stream
from runtime.recordings.folders import FolderSource
from runtime.streams.answerer import Answerer


def resident_mb() -> float:
    """Return the memory of this process that is in use, MB."""
    return float(psutil.Process().memory_info().rss / 1e6)


def main() -> None:
    """Print a table: frames done, resident MB of the predictor alone and of the pipeline."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    part = max(1, arguments.frames // 10)

    with (
        tempfile.TemporaryDirectory() as scratch,
        Predictor(size="frame", threads=arguments.threads) as engine,
    ):
        rgb, depth = bundled_stream()
        source = FolderSource(rgb, depth=depth)
        listed = source.list_frames()
        frames = [source.read(frame) for frame in listed]
        options = RunOptions(demo=True, out=Path(scratch) / "out")
        make_run_folder(options, KINDS, [frame.name for frame in listed])
        writer = FrameWriter(RunContext(options, engine, KINDS))
        print("| frames | Predictor.predict [MB] |\n|---|---|")
        for done in range(0, arguments.frames + 1, part):
            print(f"| {done} | {resident_mb():.1f} |", flush=True)
            for index in range(part if done < arguments.frames else 0):
                frame = frames[index % len(frames)]
                engine.predict(frame.rgb, frame.sparse_depth)
        dedicate_process()  # as ssdnet-run does; an embedded Predictor does not
        read = frame_reader(source)
        print("\n| frames | stream with writing [MB] |\n|---|---|")
        for done in range(0, arguments.frames + 1, part):
            print(f"| {done} | {resident_mb():.1f} |", flush=True)
            if done < arguments.frames:
                repeated = [listed[index % len(listed)] for index in range(part)]
                run_stream(Answerer(engine), repeated, read, options, outputs=[writer])


if __name__ == "__main__":
    main()
