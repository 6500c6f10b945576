"""A log on a cluster: `Predictor` as a stateful actor of Ray Data (extra `ray`).

    python examples/ray_data.py folders /logs/image_02 --depth /logs/depth --actors 8 --out answers

The numbers of the frames are sent to the actors, which open log and model themselves: both have the
same absolute paths on every node. Ray restarts an actor that died and repeats its unfinished task,
so each frame has one row.
"""

import argparse
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from runtime import HEADS, InputError, Predictor, Source, SSDNetError, choose_source

TASK_FRAMES = 8  # of a task, which is repeated when its actor dies


class PredictorActor:
    """The actor: reads and predicts frames by their numbers."""

    def __init__(self, open_source: Callable[[], Source], options: dict[str, Any]) -> None:
        self._source = open_source()
        self._frames = self._source.list_frames()
        self._predictor = Predictor(**options)

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        """Predict the frame of a row; heads of a frame without a valid answer are empty."""
        row = {**row, "reason": "", "degraded": ""}
        none = {head: np.zeros((0, 0), HEADS[head].dtype) for head in self._predictor.heads}
        try:
            listed = self._frames[row["index"]]
            if listed.name != row["name"]:
                raise InputError(f"frame {row['index']} is {listed.name} here: another log?")
            frame = self._source.read(listed)
            focal_px = None
            if frame.calibration is not None and self._predictor.focal_length_px is None:
                focal_px = frame.calibration.focal_length_px
            prediction = self._predictor.predict(
                frame.rgb, frame.sparse_depth, focal_length_px=focal_px
            )
        except SSDNetError as error:
            return {**row, "reason": str(error), **none}
        row["degraded"] = ",".join(prediction.degraded + frame.degraded)
        return {**row, **(prediction.heads if prediction.valid else none)}


def predict_source(
    open_source: Callable[[], Source], *, actors: int = 1, threads: int = 1, **options: Any
) -> Any:
    """Return a `ray.data.Dataset` with a row a frame, in any order; nothing runs yet.

    Args:
        open_source: what `choose_source` returns.
        actors: processes that predict at a time.
        threads: of an actor, which Ray counts as its processors.
        **options: further ones of `Predictor`.
    """
    import ray.data

    with open_source() as source:
        rows = [{"index": each.sequence, "name": each.name} for each in source.list_frames()]
    dataset = ray.data.from_items(rows, override_num_blocks=math.ceil(len(rows) / TASK_FRAMES))
    return dataset.map(
        PredictorActor,
        fn_constructor_args=(open_source, {**options, "threads": threads}),
        compute=ray.data.ActorPoolStrategy(size=actors),
        num_cpus=threads,
    )


def main() -> None:
    """Write the answers as Parquet files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind")
    parser.add_argument("path")
    parser.add_argument("--depth")
    parser.add_argument("--actors", type=int, default=1)
    parser.add_argument("--out", default="answers")
    given = parser.parse_args()
    log = choose_source(given.kind, given.path, depth=given.depth)
    predict_source(log, actors=given.actors).write_parquet(given.out)


if __name__ == "__main__":
    main()
