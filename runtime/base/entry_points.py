"""What installed packages add to the tables of this package, by entry points.

Your own package names in its pyproject.toml what it adds:

```toml
[project.entry-points."ssdnet.networks"]
my-network = "my_package.network:MY_NETWORK"
```

The groups are `ssdnet.networks` (a `models.registry.Entry`), `ssdnet.heads` (a
`runtime.contract.heads.Head`), `ssdnet.losses` (a `training.losses.terms.Term`) and
`ssdnet.datasets` (a subclass of `training.datasets.source_recipe.SourceRecipe`). They are looked up
only for names that the tables do not have.
"""

from typing import TypeVar

T = TypeVar("T")


def find_entry(group: str, name: str, kind: type[T]) -> T | None:
    """Load what an installed package registers under a name.

    Args:
        group: group of the entry points, for example "ssdnet.networks".
        name: name of the entry point.
        kind: type that the registered object must have.

    Returns:
        The object, or None if no package registers the name.

    Raises:
        ValueError: if the object cannot be imported or has another type.
    """
    from importlib.metadata import entry_points  # slow to import, and rarely needed

    for point in entry_points(group=group, name=name):
        try:
            loaded = point.load()
        except Exception as error:  # code of another package may raise any error
            raise ValueError(f"the entry point {group}: {name} = {point.value}: {error}") from error
        if not isinstance(loaded, kind):
            raise ValueError(
                f"the entry point {group}: {name} = {point.value} is a {type(loaded).__name__}; "
                f"expected one of the type {kind.__name__}"
            )
        return loaded
    return None


def list_entries(group: str) -> list[str]:
    """Return the names that installed packages register, for messages."""
    from importlib.metadata import entry_points

    return sorted({point.name for point in entry_points(group=group)})
