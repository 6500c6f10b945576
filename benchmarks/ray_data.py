"""What a local Ray of one and two actors answers a second, against the plain run, in turns.

    python benchmarks/ray_data.py [--frames 320] [--rounds 3] [--actors 1 2]

The bundled stream, over and over as symbolic links, is answered with every head by a plain run that
writes nothing (read-ahead, one thread of inference) and by actors of one thread each, whose rows
this process fetches. A rate is of the last three quarters of the frames: starting Ray, the
actors and the model is not in it; "to the first" is how long that took. Needs the extra `ray`.
"""

import argparse
import logging
import os
import platform
import secrets
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from runtime import Predictor
from runtime.engine_facts import cpu_name
from runtime.run.pipeline import run_stream
from runtime.run.ray_data import predict_source
from runtime.sources.bundled_stream import bundled_stream
from runtime.sources.folders import FolderSource
from runtime.sources.registry import choose_source


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=320)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--actors", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--model", help="bundled name or path")
    arguments = parser.parse_args()
    # It reports to nobody, and leaves no token in the home.
    os.environ |= {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_worker_niceness": "0",  # as the plain run
    }
    import ray

    ray.init(
        address="local",
        num_cpus=max(arguments.actors),
        object_store_memory=512 << 20,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
    )
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    print(
        f"{cpu_name()}, {os.cpu_count()} cores, ray {version('ray')}, onnxruntime "
        f"{version('onnxruntime')}, Python {platform.python_version()}; medians of "
        f"{arguments.rounds} interleaved turns of {arguments.frames} frames\n",
        flush=True,
    )
    with tempfile.TemporaryDirectory() as temporary:
        folders = _repeated(Path(temporary), arguments.frames)
        ways: dict[str, Callable[[], tuple[float, float]]] = {
            "plain run": partial(_plain, folders, arguments.model)
        }
        for actors in arguments.actors:
            dataset = partial(
                predict_source,
                choose_source(f"folders:{folders[0]}", depth=folders[1]),
                model=arguments.model,
                actors=actors,
            )
            ways[f"{actors} actor" + "s" * (actors > 1)] = partial(_rate, dataset)
        turns: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
        for _ in range(arguments.rounds):
            for way, timed in ways.items():
                turns[way].append(timed())
    first = f"{arguments.actors[0]} actor" + "s" * (arguments.actors[0] > 1)
    print(f"| | frames a second | of {first} | to the first, s |\n|---|---|---|---|")
    for way, of_way in turns.items():
        ratio = statistics.median(
            one[0] / other[0] for one, other in zip(of_way, turns[first], strict=True)
        )
        rate, start_s = (statistics.median(values) for values in zip(*of_way, strict=True))
        print(f"| {way} | {rate:.1f} | {ratio:.2f} | {start_s:.1f} |")
    ray.shutdown()


def _repeated(folder: Path, count: int) -> tuple[Path, Path]:
    """The bundled stream as often as it takes."""
    rgb, depth = bundled_stream()
    frames = FolderSource(rgb, depth=depth).list_frames()
    folders = folder / "rgb", folder / "depth"
    for made in folders:
        made.mkdir()
    for number in range(count):
        listed = frames[number % len(frames)]
        for made, path in zip(folders, (listed.image, listed.depth), strict=True):
            (made / f"{number}{path.suffix}").symlink_to(path)
    return folders


def _rate(make: Callable[[], Any]) -> tuple[float, float]:
    """Frames a second of a dataset, and seconds to its first row."""
    started = time.perf_counter()
    return _timed((row["status"] for row in make().iter_rows()), started)


def _plain(folders: tuple[Path, Path], model: str | None) -> tuple[float, float]:
    started = time.perf_counter()
    source = FolderSource(folders[0], depth=folders[1])
    times: list[tuple[float, str]] = []
    with Predictor(model, threads=1) as predictor:
        run_stream(
            predictor,
            source.list_frames(),
            read=source.read,
            on_record=lambda record: times.append((time.perf_counter(), record.status)),
        )
    return _summary(times, started)


def _timed(statuses: Iterable[str], started: float) -> tuple[float, float]:
    return _summary([(time.perf_counter(), status) for status in statuses], started)


def _summary(times: list[tuple[float, str]], started: float) -> tuple[float, float]:
    if any(status != "ok" for _, status in times):
        raise RuntimeError("a frame was not answered")
    from_here = len(times) // 4
    rate = (len(times) - 1 - from_here) / (times[-1][0] - times[from_here][0])
    return rate, times[0][0] - started


if __name__ == "__main__":
    main()
