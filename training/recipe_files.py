"""The recipes in the package, by name."""

from pathlib import Path

from runtime.errors import InputError
from training import recipes


def list_recipes() -> dict[str, Path]:
    """Return the recipes of the package by name; one in a folder is named folder-recipe."""
    folder = Path(recipes.__file__).parent
    paths = sorted(folder.rglob("*.toml"), key=lambda path: (path.parent, path.name))
    return {"-".join(path.relative_to(folder).with_suffix("").parts): path for path in paths}


def find_recipe(name: str) -> Path:
    """Return the path of a recipe; ``name`` is a path if it ends in .toml or holds a slash.

    Raises:
        InputError: for an unknown name.
    """
    if name.endswith(".toml") or "/" in name or "\\" in name:
        return Path(name)
    known = list_recipes()
    if name not in known:
        raise InputError(
            f"unknown recipe {name!r}; known: {', '.join(known)}. For a recipe of your own give a "
            "path that ends in .toml or holds a slash."
        )
    return known[name]


def describe_recipe(path: Path) -> str:
    """Return the first line of the comment at the top of a recipe."""
    return path.read_text(encoding="utf-8").splitlines()[0].removeprefix("#").strip()
