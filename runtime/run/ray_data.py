"""Predict a log on a cluster: `Predictor` as a stateful actor of Ray Data (extra `ray`).

    from runtime.run.ray_data import predict_source
    from runtime.sources.registry import choose_source

    log = choose_source("kitti-raw:/logs/2011_09_26_drive_0001_sync")  # any source
    answers = predict_source(log, actors=8)  # nothing runs yet
    answers.write_parquet("answers")  # or iter_rows(), map(), ...

Only the numbers of the frames are sent to the actors, which open the log and the model themselves:
both must have the same absolute paths on every node. Ray restarts an actor that died and repeats
its unfinished task, so each frame has one row.
"""

import math
from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundled_models import find_model
from runtime.errors import InputError
from runtime.heads import HEADS
from runtime.model_file import load_model_file
from runtime.predictor import Predictor
from runtime.run.pipeline import answer_frame, timed_read
from runtime.run.process import dedicate_process
from runtime.sources.frames import Frame
from runtime.sources.source import Source

_TASK_FRAMES = 8  # of a task, which is repeated when its actor dies


def predict_source(
    open_source: Callable[[], Source],
    *,
    model: str | PathLike[str] | None = None,
    heads: Sequence[str] | None = None,
    limit: int | None = None,
    actors: int = 1,
    threads: int = 1,
    gpus: float = 0,
    **options: Any,
) -> Any:
    """Return a `ray.data.Dataset` of the answers to every frame of a source, a row a frame.

    A row holds: index (in the list of frames), name, status ("ok"; "skipped": could not be read or
    predicted; "invalid": the answer cannot be used), reason (of the other two), degraded (as
    `Prediction.degraded`, joined with commas), latency_ms (NaN if skipped), the stamps of both
    sensors (None = not known), and an array a head as in `Prediction.heads`, empty unless the
    status is "ok". The order of the rows is not defined.

    Args:
        open_source: what `choose_source` returns, or anything that can be pickled and opens a
            `Source`.
        model: as `Predictor` takes it. Its digest is checked by every actor.
        heads: of the model, which of them the rows hold; None = all.
        limit: see `Source.list_frames`.
        actors: processes that predict at a time. The cluster should have `threads` processors for
            each.
        threads: of an actor, which Ray counts as its processors.
        gpus: of an actor, with provider="cuda": 1, or 0.5 if two share one.
        **options: further ones of `Predictor`. The focal length is by default that of the source's
            calibration.

    Raises:
        InputError: if the source has no frames, or a count is out of range.
        ContractError: if the model cannot be read.

    Errors of an actor while it starts are raised by Ray as its own errors.
    """
    import ray.data

    for name, count in (("actors", actors), ("threads", threads)):
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise InputError(f"{name} must be a whole number of at least 1, got {count!r:.40}")
    if options.get("provider") == "cuda" and not gpus > 0:
        raise InputError("provider cuda needs gpus=, of each actor: Ray hides them from others")
    path = find_model(model)
    options = {
        **options,
        "model": model if model is None else str(path.resolve()),
        "sha256": load_model_file(path, sha256=options.get("sha256")).sha256,
        "threads": threads,
    }
    with open_source() as source:
        frames = source.list_frames(limit=limit)
    if not frames:
        raise InputError("the source has no frames")
    rows = [{"index": index, "name": listed.name} for index, listed in enumerate(frames)]
    dataset = ray.data.from_items(rows, override_num_blocks=math.ceil(len(rows) / _TASK_FRAMES))
    return dataset.map(
        FramePredictor,
        fn_constructor_args=(open_source, limit, None if heads is None else tuple(heads), options),
        compute=ray.data.ActorPoolStrategy(size=actors),
        num_cpus=threads,
        num_gpus=gpus,
    )


class FramePredictor:
    """The actor: reads and predicts frames by their numbers."""

    def __init__(
        self,
        open_source: Callable[[], Source],
        limit: int | None,
        heads: tuple[str, ...] | None,
        options: dict[str, Any],
    ) -> None:
        """Open source and model. Raises InputError for a head that the model lacks."""
        dedicate_process()
        self._source = open_source()
        self._frames = self._source.list_frames(limit=limit)
        if options.get("focal_length_px") is None and self._source.calibration is not None:
            options = {**options, "focal_length_px": self._source.calibration.focal_length_px}
        self._predictor = Predictor(**options)
        self._heads = self._predictor.heads if heads is None else heads
        if missing := set(self._heads) - set(self._predictor.heads):
            raise InputError(
                f"heads asks for {', '.join(sorted(missing))}, the model "
                f"{self._predictor.contract.model_name} answers {', '.join(self._predictor.heads)}"
            )

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        """Predict the frame of a row; see `predict_source`."""
        index, name = int(row["index"]), str(row["name"])
        answer = answer_frame(self._predictor, index, name, lambda: self._read(index, name))
        record, prediction = answer.record, answer.prediction
        heads = prediction.heads if prediction is not None and prediction.valid else {}
        return {
            "index": index,
            "name": name,
            "status": record.status,
            "reason": record.reason,
            "degraded": ",".join(record.degraded),
            "latency_ms": math.nan if record.latency is None else record.latency.total_ms,
            "image_stamp_ns": record.image_stamp_ns,
            "depth_stamp_ns": record.depth_stamp_ns,
            **{head: heads.get(head, _nothing(head)) for head in self._heads},
        }

    def _read(self, index: int, name: str) -> tuple[Frame, float]:
        if index >= len(self._frames) or self._frames[index].name != name:
            raise InputError(f"{name} is not frame {index} here: is it the same log everywhere?")
        return timed_read(self._source.read, self._frames[index])


def _nothing(head: str) -> NDArray[Any]:
    """An empty array of the dtype and rank of a head: a column holds one of each."""
    return np.zeros((0,) * (3 if HEADS[head].per_class else 2), HEADS[head].dtype)
