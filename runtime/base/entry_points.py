"""What installed packages add to the tables of this package, by entry points.

Your own package names in its pyproject.toml what it adds:

```toml
[project.entry-points."ssdnet.networks"]
my-network = "my_package.network:MY_NETWORK"
```

The groups are `ssdnet.networks` (a `models.registry.Entry`), `ssdnet.heads` (a
`runtime.contract.heads.Head`), `ssdnet.losses` (a `training.losses.terms.Term`) and
`ssdnet.datasets` (a subclass of `training.datasets.source_recipe.SourceRecipe`). A name belongs to
one package: one that two have, or a package and a table of this one, is an error where it is used.
"""

import sys
from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")


@cache
def _values(group: str, path: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Return, for each name of a group, the different entry points by what they point to."""
    from importlib.metadata import entry_points  # slow to import, and rarely needed

    found: dict[str, dict[str, Any]] = {}
    for point in entry_points(group=group):
        found.setdefault(point.name, {})[point.value] = point
    return found


def find_entry(
    group: str, name: str, kind: type[T], table: Mapping[str, T] | None = None
) -> T | None:
    """Return what a table, or an installed package, has under a name.

    Args:
        group: group of the entry points, for example "ssdnet.networks".
        name: name of the entry point.
        kind: type that the registered object must have.
        table: what this package has by name.

    Returns:
        The object, or None if neither has the name.

    Raises:
        ValueError: if several have it, or if the object cannot be imported or has another type.
    """
    points = _values(group, tuple(sys.path)).get(name, {})
    own = None if table is None else table.get(name)
    if len(points) + (own is not None) > 1:
        owners = [*["a name of this package"] * (own is not None), *points]
        raise ValueError(
            f"the entry point {group}: {name} is {' and '.join(owners)}: rename it in your package"
        )
    for value, point in points.items():
        try:
            loaded = point.load()
        except Exception as error:  # code of another package may raise any error
            raise ValueError(f"the entry point {group}: {name} = {value}: {error}") from error
        if not isinstance(loaded, kind):
            raise ValueError(
                f"the entry point {group}: {name} = {value} is a {type(loaded).__name__}; "
                f"expected one of the type {kind.__name__}"
            )
        return loaded
    return own


def list_entries(group: str, table: Mapping[str, Any]) -> list[str]:
    """Return the names of a table, and those that installed packages register, for messages."""
    return [*table, *sorted(_values(group, tuple(sys.path)).keys() - table.keys())]
