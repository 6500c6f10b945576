"""The table `validation` of a recipe: the sets on which it is scored, and how."""

from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import InputError
from training.base.limits import STRICT, Positive, Steps
from training.datasets.registry import AnySource
from training.lidar.split import LidarInput


def _require_lidar(text: str) -> str:
    try:
        LidarInput.parse(text)
    except InputError as error:
        raise ValueError(str(error)) from error
    return text


@dataclass(frozen=True, config=STRICT)
class ValidationRecipe:
    """Data sets on which the averaged weights are scored during training.

    Attributes:
        every: steps between two validations; None: see `Recipe`.
        lidar: the LiDAR input of the validation, see `training.lidar.split.LidarInput`.
        farthest_m: farthest true depth [m] that is scored.
        pictures: number of frames of each set, at equal distances, that TensorBoard shows as
            pictures.
        best: score by which best.pt is chosen, "SET/SCORE", for example "camvid/miou"; scores are
            the columns of scores.csv. "": that of the first set, miou, or mae_m if it has no
            labels.
    """

    every: Steps | None = None
    lidar: Annotated[str, AfterValidator(_require_lidar)] = "own"
    farthest_m: Positive = 100.0
    source: Annotated[tuple[AnySource, ...], Field(max_length=100)] = ()
    pictures: Annotated[int, Field(ge=0, le=1000)] = 2
    best: str = ""

    def __post_init__(self) -> None:
        """Check the names of the sets and of the best score."""
        titles = [item.title for item in self.source]
        twice = sorted({title for title in titles if titles.count(title) > 1})
        if twice:
            raise ValueError(
                f"source has two sets with the title {twice[0]!r}, so their scores could not be "
                "told apart: give each its own `name`"
            )
        if self.best and self.best.rpartition("/")[0] not in titles:
            raise ValueError(
                f"best = {self.best!r}; expected SET/SCORE of one of the sets {titles}, for "
                "example 'camvid/miou'"
            )
