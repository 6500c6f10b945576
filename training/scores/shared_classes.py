"""The classes in which several models are scored on a set: those that all have, by their names."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from training.datasets.class_mapping import ClassTable, is_mapped, list_classes
from training.datasets.class_names import relatives
from training.datasets.source_recipe import SourceRecipe


@dataclass(frozen=True)
class ScoredClasses:
    """The classes in which all models are scored on a set, by their names.

    Attributes:
        table: the table with which the set is opened.
        names: names of the classes that the set and every model with classes have.
        left_out: the other classes in words; empty if there are none.
        joined: for each class, in lower case, the class that it counts as.
    """

    table: ClassTable
    names: tuple[str, ...]
    left_out: str = ""
    joined: Mapping[str, str] = field(default_factory=dict)

    def lookup(self, table: ClassTable, others: int) -> NDArray[np.uint8]:
        """Return a look-up table (256,) from a table's ids to those of `names`, or `others`."""
        known = {name.lower(): index for index, name in enumerate(self.names)}
        names = [self.joined.get(info.name.lower(), info.name) for info in list_classes(table)]
        ids = np.full(256, others, np.uint8)
        ids[: len(names)] = [known.get(name.lower(), others) for name in names]
        return ids


def share_classes(
    recipe: SourceRecipe,
    title: str,
    tables: Mapping[str, ClassTable],
    ids: ClassTable | None,
    joined: Mapping[str, str],
) -> ScoredClasses:
    """Return the classes of a set in which models are scored.

    If all models have the same table and the labels are mapped to it, these are its classes.
    Otherwise they are the classes whose names, in any case of letters, the set and every model
    have.

    Args:
        recipe: recipe of the set.
        title: title of the set.
        tables: class tables of the models that have one.
        ids: the classes of labels whose recipe names none; None: those of the models.
        joined: see `join_names`.

    Raises:
        InputError: if the labels are ids of no named classes, and the models have several tables.
    """
    own = recipe.label_table if recipe.label_table is not None else ids
    first = next(iter(tables.values()), "camvid")
    unjoined = {name: _names(table, {}) for name, table in tables.items()}
    same = len({tuple(names) for names in unjoined.values()}) < 2
    if own is None and not same:
        several = "; ".join(f"{name}: {', '.join(of.values())}" for name, of in unjoined.items())
        raise InputError(
            f"{title}: its labels are numbers, and the models have different classes ({several}): "
            'name the numbers, for example label_ids={0 = "road", 1 = "car"}, or give the folder '
            "of the run that was trained on them in place of its model"
        )
    table = first if own is None or (same and is_mapped(own, first)) else own
    every = {where: _names(of, joined) for where, of in {title: table, **tables}.items()}
    shared = set.intersection(*map(set, every.values()))
    names = tuple(name for lower, name in every[title].items() if lower in shared)
    alone = {
        where: [name for lower, name in found.items() if lower not in shared]
        for where, found in every.items()
    }
    left_out = "; ".join(f"{', '.join(found)} ({where})" for where, found in alone.items() if found)
    if left_out:
        outcome = (
            "left out of the mean, as a class must be one of the set and of every model"
            if names
            else "classes are not scored, as none of the set is one of every model"
        )
        left_out = f"{title}: {outcome}: {left_out}"
    return ScoredClasses(table, names, left_out, joined)


def join_names(groups: Mapping[str, Sequence[str]], tables: Iterable[ClassTable]) -> dict[str, str]:
    """Return, for each class in lower case, the class of `groups` that it counts as.

    Args:
        groups: for each joint class, the classes that count as it, such as `vehicle = ["car",
            "truck"]`.
        tables: tables of the sets and models, to find names that none of them has.

    Raises:
        InputError: if a class is in two groups, or if no set and no model has it.
    """
    known = {info.name.lower() for table in tables for info in list_classes(table)}
    joined: dict[str, str] = {}
    written: dict[str, str] = {}
    for group, names in groups.items():
        if (other := written.setdefault(group.lower(), group)) != group:
            raise InputError(f"{group} and {other}: differ in case only: write one of them")
        for name in names:
            if name.lower() not in known:
                raise InputError(
                    f"{group} = {list(names)}: no set and no model has the class {name!r}: "
                    f"leave it out, or name one of theirs ({', '.join(sorted(known)) or 'none'})"
                )
            if joined.setdefault(name.lower(), group) != group:
                raise InputError(
                    f"the class {name!r} is to count as {joined[name.lower()]!r} and as "
                    f"{group!r}: keep one of them"
                )
    return joined


def draft_join(
    own: ClassTable, tables: Iterable[ClassTable], united: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    """Return joint classes, by the meanings of names, in which more labels of a set are scored.

    A class that means none of a model's is alone in its line, to which a user adds others.

    Args:
        own: classes of the labels.
        tables: class tables of the models.
        united: for classes that unite others, the names of these.
    """
    groups: list[tuple[str, set[str]]] = []
    alone = []
    models = [[info.name for info in list_classes(table)] for table in tables]
    for name in [info.name for info in list_classes(own)]:
        wanted = united.get(name) or (name,)
        found = {other for known in models for each in wanted for other in relatives(each, known)}
        alone += [] if found or not models else [name]
        # Classes of the set that mean the same class of a model count as one.
        same = [group for group in groups if group[1] & found]
        members = {name}.union(found, *(group[1] for group in same))
        groups = [group for group in groups if group not in same]
        groups.append((same[0][0] if same else name, members))
    # A group whose names are equal beyond upper and lower case needs no line.
    return {
        title: sorted(members)
        for title, members in groups
        if title in alone or len({name.lower() for name in members}) > 1
    }


def _names(table: ClassTable, joined: Mapping[str, str]) -> dict[str, str]:
    """Return the names of the classes, joined, by these names in lower case."""
    names = (joined.get(info.name.lower(), info.name) for info in list_classes(table))
    return {name.lower(): name for name in names}
