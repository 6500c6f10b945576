"""The kinds of data sets that recipes, and the --data of commands, can name.

A new kind needs its file and a line here, or an entry point of another package.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import Discriminator, PlainValidator, Tag
from pydantic_core import PydanticCustomError

from models import CLASS_TABLES
from runtime.base.entry_points import find_entry, list_entries
from runtime.base.errors import InputError
from training.base.tables import TAGS, build, parse_pairs
from training.datasets.camvid import CamVidRecipe
from training.datasets.cityscapes import CityscapesRecipe
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_depth import KittiDepthRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.recording import RecordingRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import RenderedRecipe, VirtualKitti1Recipe, VirtualKittiRecipe

DATASETS: dict[str, type[SourceRecipe]] = {
    "camvid": CamVidRecipe,
    "cityscapes": CityscapesRecipe,
    "folders": FoldersRecipe,
    "kitti-depth": KittiDepthRecipe,
    "kitti-stream": KittiStreamRecipe,
    "kitti-streets": KittiStreetsRecipe,
    "recording": RecordingRecipe,
    "rendered": RenderedRecipe,
    "virtual-kitti": VirtualKittiRecipe,
    "virtual-kitti-1": VirtualKitti1Recipe,
}
# Group of the entry points with which other packages add data sets.
GROUP = "ssdnet.datasets"


def find_dataset(kind: str) -> type[SourceRecipe] | None:
    """Return the options of a kind of data set; None if the kind is unknown.

    Raises ValueError if what a package registers is not a subclass of `SourceRecipe`, or has labels
    of an unknown table, and in the cases of `find_entry`.
    """
    found = find_entry(GROUP, kind, type, DATASETS)
    if found is None:
        return None
    if not issubclass(found, SourceRecipe):
        raise ValueError(f"the entry point {GROUP}: {kind} is no subclass of SourceRecipe")
    if found.labelled and found.labelled not in CLASS_TABLES:
        raise ValueError(
            f"the entry point {GROUP}: {kind} has labelled = {found.labelled!r}; expected one of "
            f"{', '.join(CLASS_TABLES)}, or none for labels of `model.classes`"
        )
    return found


# The tag of data sets of other packages.
_REGISTERED = "(registered)"
TAGS |= {**DATASETS, _REGISTERED: SourceRecipe}


def _kind_of(value: Any) -> str | None:
    """Return the kind of a data set, or the tag of those that another package registers."""
    kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
    try:
        is_own = not isinstance(kind, str) or find_dataset(kind) is DATASETS.get(kind, "none")
    except ValueError:  # raised again where it becomes an error of this data set
        is_own = False
    return kind if is_own else _REGISTERED


def _read_registered(value: Any) -> SourceRecipe:
    """Read a data set of another package by its own keys."""
    if isinstance(value, SourceRecipe):
        return value
    kind = find_dataset(value["kind"])
    if kind is None:
        known = ", ".join(list_entries(GROUP, DATASETS))
        text = f"unknown kind of data set {value['kind']!r}: give one of {known}"
        raise PydanticCustomError("registered", "{text}", {"text": text})
    try:
        return build(kind, value)
    except InputError as error:
        raise PydanticCustomError("registered", "{text}", {"text": str(error)}) from error


if TYPE_CHECKING:
    AnySource = SourceRecipe
else:
    # A data set of any kind, by its key `kind`.
    AnySource = Annotated[
        Union[
            *(Annotated[kind, Tag(name)] for name, kind in DATASETS.items()),
            Annotated[SourceRecipe, PlainValidator(_read_registered), Tag(_REGISTERED)],
        ],
        Discriminator(
            _kind_of,
            custom_error_type="kind",
            custom_error_message="kind names the kind of the data set, a text",
        ),
    ]


def parse_data(text: str) -> SourceRecipe:
    """Read the --data of a command, KIND:FOLDER[,KEY=VALUE...].

    A text needs no quotes, even if it looks like a number or a date. Raises InputError if the form
    is another one, a kind or key is unknown, a key is given twice, or a value has the wrong type.
    """
    head, table = parse_pairs(
        "--data", text, lambda head: find_dataset(head.partition(":")[0]) or SourceRecipe
    )
    kind, colon, folder = head.partition(":")
    if not colon:
        raise InputError(f"--data {text!r}: write it as KIND:FOLDER[,KEY=VALUE...]")
    return build(AnySource, {"kind": kind, "path": folder, **table}, f"--data {text!r}: ")
