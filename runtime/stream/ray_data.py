"""Answer a log on a cluster: `Predictor` as a stateful actor of Ray Data (extra `ray`).

    import ray
    from runtime.stream.ray_data import predict_folders

    answers = predict_folders("image_02", "sparse_depth_02", actors=8)  # nothing runs yet
    answers.write_parquet("answers")  # or iter_rows(), map(), ...

Only the numbers of the frames travel to the actors, which open the folders and the model
themselves: both must lie at the same paths on every node. Ray starts an actor that died anew and
repeats what it had not handed over, so each frame is answered once, whatever is killed.
"""

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundled_models import find_model
from runtime.errors import InputError, SSDNetError
from runtime.model_file import load_model_file
from runtime.predictor import Predictor
from runtime.stream.frames import KITTI_DEPTH_SCALE, list_frames, read_frame
from runtime.stream.pipeline import INVALID, OK, SKIPPED
from runtime.stream.process import dedicate_process

#: What a row holds besides an array a head.
COLUMNS = ("index", "name", "status", "reason", "degraded", "latency_ms")
_TASK_FRAMES = 8  # that an actor takes at a time: what is repeated when it dies
_DTYPES = {"semantic": np.uint8}  # of a head; all others are float32
_RANKS = {"semantic_logits": 3}  # all others are pictures


def predict_folders(
    rgb_dir: str | PathLike[str],
    depth_dir: str | PathLike[str],
    *,
    model: str | PathLike[str] | None = None,
    heads: Sequence[str] | None = None,
    depth_scale: float = KITTI_DEPTH_SCALE,
    actors: int = 1,
    threads: int = 1,
    gpus: float = 0,
    **options: Any,
) -> Any:
    """Return a `ray.data.Dataset` of the answers to every frame of two folders, a row a frame.

    rgb_dir, depth_dir, depth_scale: as `list_frames` and `read_frame` take them
    heads: of the model, which of them the rows hold; None = all
    actors: how many predict at a time, each in a process of its own; give as many as the cluster
        has `threads` processors for
    threads: of an actor, which Ray counts as its processors
    gpus: of an actor, with provider="cuda": 1, or 0.5 if two share one
    options: further ones of `Predictor`

    A row: index (of the frame in its log), name, status ("ok"; "skipped": could not be read or
    predicted; "invalid": the answer cannot be used), reason (of the other two), degraded (as
    `Prediction.degraded`, joined with commas), latency_ms (NaN where skipped), and an array a head
    as `Prediction` has it, of shape (0, 0) unless the status is "ok". Rows come in any order.

    Raises InputError for folders without frames and for what Ray cannot take, ContractError for a
    model that cannot be read. That the answers come from the same model file everywhere is checked
    by its digest; what an actor raises when it starts comes out of Ray as its own error.
    """
    import ray.data

    for name, count in (("actors", actors), ("threads", threads)):
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise InputError(f"{name} must be a whole number of at least 1, got {count!r:.40}")
    frames = list_frames(Path(rgb_dir), Path(depth_dir))
    path = find_model(model)
    rows = [{"index": index, "name": files.name} for index, files in enumerate(frames)]
    dataset = ray.data.from_items(rows, override_num_blocks=math.ceil(len(rows) / _TASK_FRAMES))
    return dataset.map(
        FramePredictor,
        fn_constructor_kwargs={
            "rgb_dir": Path(rgb_dir).resolve(),
            "depth_dir": Path(depth_dir).resolve(),
            "depth_scale": depth_scale,
            "heads": None if heads is None else tuple(heads),
            "options": {
                **options,
                "model": model if model is None else str(path.resolve()),
                "sha256": load_model_file(path, sha256=options.get("sha256")).sha256,
                "threads": threads,
            },
        },
        compute=ray.data.ActorPoolStrategy(size=actors),
        num_cpus=threads,
        num_gpus=gpus,
    )


class FramePredictor:
    """The actor: a `Predictor` that reads and answers the frames it is given the numbers of."""

    def __init__(
        self,
        rgb_dir: Path,
        depth_dir: Path,
        depth_scale: float,
        heads: tuple[str, ...] | None,
        options: dict[str, Any],
    ) -> None:
        """Open folders and model. Raises InputError for a head that the model lacks."""
        dedicate_process()
        self._frames = list_frames(rgb_dir, depth_dir)
        self._depth_scale = depth_scale
        self._predictor = Predictor(**options)
        self._heads = self._predictor.heads if heads is None else heads
        if missing := set(self._heads) - set(self._predictor.heads):
            raise InputError(
                f"heads asks for {', '.join(sorted(missing))}, the model "
                f"{self._predictor.contract.model_name} answers {', '.join(self._predictor.heads)}"
            )

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        """Answer the frame of a row; see `predict_folders`."""
        index, name = int(row["index"]), str(row["name"])
        answer: dict[str, Any] = {"index": index, "name": name, "reason": "", "degraded": ""}
        answer |= {"latency_ms": math.nan} | {head: _nothing(head) for head in self._heads}
        try:
            files = self._frames[index] if index < len(self._frames) else None
            if files is None or files.name != name:
                raise InputError(f"{name} is not frame {index} here: other folders than at first?")
            frame = read_frame(files, depth_scale=self._depth_scale)
            prediction = self._predictor.predict(frame.rgb, frame.sparse_depth)
        except SSDNetError as error:
            return answer | {"status": SKIPPED, "reason": str(error)}
        answer["latency_ms"] = prediction.latency.total_ms
        answer["degraded"] = ",".join(prediction.degraded)
        if not prediction.valid:
            return answer | {"status": INVALID, "reason": ", ".join(prediction.degraded)}
        return answer | {"status": OK} | {head: getattr(prediction, head) for head in self._heads}


def _nothing(head: str) -> NDArray[Any]:
    """An array without an element, of the type of a head: a column holds one rank and type."""
    return np.zeros((0,) * _RANKS.get(head, 2), _DTYPES.get(head, np.float32))
