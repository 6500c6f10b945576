"""Print pip constraints with the lowest versions of the engine's needs that pyproject.toml allows.

The needs of these packages stay as in constraints.txt. Run it in the root of the checkout.
"""

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
needs = [*project["dependencies"], *project["optional-dependencies"]["cpu"]]
lowest = {}
for need in map(Requirement, needs):
    (bound,) = [spec.version for spec in need.specifier if spec.operator == ">="]
    lowest[canonicalize_name(need.name)] = bound
known = {
    canonicalize_name(name): version
    for name, _, version in (
        line.partition("==") for line in Path("constraints.txt").read_text().splitlines()
    )
    if version
}
for name, version in {**known, **lowest}.items():
    print(f"{name}=={version}")
