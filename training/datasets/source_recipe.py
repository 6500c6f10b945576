"""What a recipe says about a data set: the keys that every kind has."""

from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field
from pydantic.dataclasses import dataclass

from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource
from training.limits import STRICT, FactorRange, Positive, Side

#: Names of scenes, variants or drives.
Names = Annotated[tuple[str, ...], Field(min_length=1, max_length=10_000)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SourceRecipe:
    """One data set of the mixture, or one of the validation sets.

    Each kind is a subclass beside its reader, listed in `training.datasets.registry`: its name as
    the default of ``kind``, a Literal, its own keys, and `open`.
    """

    kind: str
    #: Folder, relative to one of the ``--data`` folders.
    path: Annotated[str, Field(min_length=1)]
    #: How often it is drawn, relative to the others.
    weight: Positive = 1.0
    #: (height, width) that every frame is brought to first; its own size by default.
    size: tuple[Side, Side] | None = None
    #: Range of the random magnification; the common one by default.
    scale: FactorRange | None = None

    #: Whether there is a folder to read.
    on_disk: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """What scores of the set are called."""
        return self.path or self.kind

    def open(self, folder: Path, classes: ClassTable) -> SampleSource:
        """Open the data set; ``classes`` is the table of the class ids. Raises DatasetError."""
        raise NotImplementedError
