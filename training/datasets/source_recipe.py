"""Options of a data set in a recipe: the keys that every kind has."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import MAX_NAME_LENGTH
from training.base.limits import STRICT, FactorRange, Index, Positive, Side
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource

T = TypeVar("T")

SetName = Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
# Names of scenes or variants.
Names = Annotated[tuple[str, ...], Field(min_length=1, max_length=10_000)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SourceRecipe:
    """One data set of the mixture, or one of the validation sets.

    Each kind is a subclass in its reader's file, listed in `training.datasets.registry`. It has its
    name as the default of `kind`, a Literal, its own keys, and `open`.

    Attributes:
        labelled: name in `models.CLASS_TABLES` of the classes for which the kind has labels; "" if
            it has none.
        unit_key: key with which the user states the unit of the depth; "" if the format has one
            unit.
        states_camera: whether the user states the camera, which is then checked by the images.
        may_be_file: whether `path` may be a file.
        path: folder, relative to one of the `--data` folders.
        weight: how often the set is sampled, relative to the others.
        size: (height, width) to which every frame is resized first, or a number of rows, with which
            the aspect is kept; None: its own size.
        scale: range of the random magnification; None: the common range.
        name: name in scores, curves and files; None: the path.
    """

    labelled: ClassVar[str] = ""
    unit_key: ClassVar[str] = ""
    states_camera: ClassVar[bool] = False
    may_be_file: ClassVar[bool] = False

    kind: str
    path: Annotated[str, Field(min_length=1)]
    weight: Positive = 1.0
    size: tuple[Side, Side] | Side | None = None
    scale: FactorRange | None = None
    name: SetName | None = None

    @property
    def title(self) -> str:
        """Name of the set in scores, curves and files."""
        return self.name or self.path

    @property
    def folders(self) -> tuple[str, ...]:
        """The folders that hold the files, relative to one of the `--data` folders."""
        return (self.path,)

    @property
    def label_table(self) -> ClassTable | None:
        """The classes of the labels: a name in `models.CLASS_TABLES` or a table, () without labels.

        None means that the labels are ids of the table with which the set is opened.
        """
        return self.labelled or ()

    def open(self, folder: Path, classes: ClassTable) -> SampleSource:
        """Open the data set.

        Args:
            folder: folder of the set.
            classes: table of the class ids.

        Raises:
            DatasetError: if the folder does not have the layout of this kind.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RangeRecipe(SourceRecipe):
    """A set of which a range of frames may be taken.

    Attributes:
        first: first and last frame, from 0, inclusive.
        parts: first and last frame of each part that is taken; (): all of this range.
    """

    first: Index = 0
    last: Index | None = None
    parts: Annotated[tuple[tuple[Index, Index], ...], Field(max_length=10_000)] = ()

    def take(
        self, frames: Sequence[T], folder: Path, number: Callable[[T], int] | None = None
    ) -> list[T]:
        """Return the frames of the range, by their place in the list or by `number`.

        Raises:
            DatasetError: if the range has no frame.
        """
        last = float("inf") if self.last is None else self.last
        parts, taken = self.parts or ((self.first, last),), []
        for place, frame in enumerate(frames):
            at = number(frame) if number else place
            if self.first <= at <= last and any(a <= at <= b for a, b in parts):
                taken.append(frame)
        if not taken:
            raise DatasetError(
                f"{folder}: {len(frames)} images, none of them in {self.first}.."
                f"{'' if self.last is None else self.last}: correct `first`, `last` and `parts`"
            )
        return taken
