"""The scores of all validations as a table, and the best validation."""

import csv
import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from runtime.base.errors import InputError
from runtime.files.atomic_write import atomic_write

# Scores of a set that the progress line and TensorBoard show.
SHOWN = ("miou", "mae_m", "rmse_m", "boundary_f")
# Prefixes of scores that are errors, for which smaller is better.
_ERRORS = ("mae", "rmse", "imae", "irmse", "mean_error")
# Relative change for the worse from which `ScoreTable.compare` warns.
_TOLERANCE = 0.05


class ScoreTable:
    """A CSV file with one row per step and set: "step", "set", and one column per score.

    Rows of steps after `step` are dropped, at step 0 all: an interrupted run computes them again.
    """

    def __init__(self, path: Path, step: int) -> None:
        self._path = path
        self._rows: list[dict[str, str]] = []
        if not path.is_file():
            return
        with path.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        try:
            self._rows = [row for row in rows if int(row["step"]) <= step and step > 0]
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(
                f"{path}: is not the table of a training ({error!r}): restore or remove it"
            ) from error

    def __contains__(self, step: int) -> bool:
        """Return whether the scores of a step are in the table."""
        return any(row["step"] == str(step) for row in self._rows)

    def add(self, step: int, scores: Mapping[str, Mapping[str, float]], best: str) -> bool:
        """Write the scores of a step; return whether the score `best` is the best so far.

        `best` is "SET/SCORE", or "" for the first set's miou or, without labels, mae_m.
        OutputError if the file cannot be written.
        """
        name, _, figure = best.rpartition("/")
        if not best:  # there is no figure if the first set has neither labels nor depth
            name = next(iter(scores))
            figure = next((key for key in ("miou", "mae_m") if key in scores[name]), "")
        before = [
            float(row[figure]) for row in self._rows if row["set"] == name and row.get(figure)
        ]
        self._rows += [
            {"step": str(step), "set": item, **{key: repr(value) for key, value in figures.items()}}
            for item, figures in scores.items()
        ]
        columns = dict.fromkeys(key for row in self._rows for key in row)
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, list(columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self._rows)
        atomic_write(self._path, text.getvalue().encode())
        if not figure:
            return False
        sign = -1 if _is_error(figure) else 1
        now = sign * scores[name][figure]
        return not math.isnan(now) and all(
            now > sign * value for value in before if not math.isnan(value)
        )

    @property
    def curves(self) -> dict[tuple[str, str], list[tuple[int, float]]]:
        """For each set and each shown score: the steps and values of all validations."""
        found: dict[tuple[str, str], list[tuple[int, float]]] = {}
        for row in self._rows:
            for key in SHOWN:
                if (value := float(row.get(key) or "nan")) == value:
                    found.setdefault((row["set"], key), []).append((int(row["step"]), value))
        return found

    def compare(self) -> Iterator[str]:
        """Yield a table of the shown scores before the first step and now, and what became worse.

        It yields nothing if step 0 was not scored.
        """
        pairs = {
            f"{name}/{key}": (points[0][1], points[-1][1])
            for (name, key), points in self.curves.items()
            if points[0][0] == 0 and len(points) > 1
        }
        if not pairs:
            return
        width = max(map(len, pairs))
        yield f"{'':{width}}  before   after"
        for name, (first, last) in pairs.items():
            yield f"{name:{width}}  {first:6.4f}  {last:6.4f}"
        for name, (first, last) in pairs.items():
            loss = (last - first) * (1 if _is_error(name) else -1)
            if loss > _TOLERANCE * first:
                yield (
                    f"warning: {name} became worse, from {first:.4g} to {last:.4g}: compare the "
                    "data and the loss with those of --init, or lower optimizer.learning_rate; "
                    "best.pt is chosen by validation.best alone"
                )


def _is_error(figure: str) -> bool:
    """Whether a score is an error: the smaller the better. Of "SET/SCORE" the score counts."""
    return figure.rpartition("/")[2].startswith(_ERRORS)
