"""Options of a data set in a recipe: the keys of every kind."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import MAX_NAME_LENGTH
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource
from training.limits import STRICT, FactorRange, Index, Positive, Side

T = TypeVar("T")

SetName = Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
#: Names of scenes, variants or drives.
Names = Annotated[tuple[str, ...], Field(min_length=1, max_length=10_000)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SourceRecipe:
    """One data set of the mixture, or one of the validation sets.

    Each kind is a subclass in its reader's file, listed in `training.datasets.registry`: it has its
    name as the default of `kind`, a Literal, its own keys, and `open`.
    """

    #: Name in `models.CLASS_TABLES` of the classes that the kind has labels of; "" of none.
    labelled: ClassVar[str] = ""
    #: The key with which the user states the unit of the depth; "" where the format has one.
    unit_key: ClassVar[str] = ""

    kind: str
    #: Folder, relative to one of the `--data` folders.
    path: Annotated[str, Field(min_length=1)]
    #: How often it is sampled, relative to the others.
    weight: Positive = 1.0
    #: (height, width) that every frame is resized to first, or rows, at which it keeps its aspect;
    #: its own size by default.
    size: tuple[Side, Side] | Side | None = None
    #: Range of the random magnification; the common one by default.
    scale: FactorRange | None = None
    #: Name in scores, curves and files; the path by default.
    name: SetName | None = None

    @property
    def title(self) -> str:
        """What it is called."""
        return self.name or self.path

    @property
    def label_table(self) -> ClassTable | None:
        """The classes of the labels: a name in `models.CLASS_TABLES`, or a table; () of no labels.

        None: the labels are ids of the table that the set is opened with.
        """
        return self.labelled or ()

    def open(self, folder: Path, classes: ClassTable) -> SampleSource:
        """Open the data set.

        Args:
            folder: where it is.
            classes: table of the class ids.

        Raises:
            DatasetError: if the folder does not have its layout.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RangeRecipe(SourceRecipe):
    """A set of which a range of frames may be taken."""

    #: First and last frame, from 0, inclusive.
    first: Index = 0
    last: Index | None = None

    def take(
        self, frames: Sequence[T], folder: Path, number: Callable[[T], int] | None = None
    ) -> list[T]:
        """Return the frames of the range, by their place or by `number`.

        Raises:
            DatasetError: if there is none.
        """
        last = float("inf") if self.last is None else self.last
        taken = [
            frame
            for place, frame in enumerate(frames)
            if self.first <= (number(frame) if number else place) <= last
        ]
        if not taken:
            raise DatasetError(
                f"{folder}: {len(frames)} images, none of them in {self.first}.."
                f"{'' if self.last is None else self.last}. Correct `first` and `last`."
            )
        return taken
