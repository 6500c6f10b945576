"""What a checkpoint says about the training of its weights."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from runtime.contract.contract import ClassInfo, check_side


@dataclass(frozen=True)
class TrainingFacts:
    """What a file says about the training of its weights; the file holds it as plain values.

    Attributes:
        data: titles of the data sets that the weights were trained on.
        terms: data and terms that a model card and an exported file must state.
        trained_height: height [px] of the images that the network was trained for; None = unknown.
        recipe: the resolved recipe, as plain values.
        crop: (height, width) of the training crops; None = unknown.
        init: the weights that the training started from; None = random weights.
        teacher: the weights whose answers the network was trained to give; None = none.
        processes: number of processes that trained together.
        step: number of the training step of these weights; None = unknown.
    """

    data: tuple[str, ...] = ()
    terms: str = ""
    trained_height: int | None = None
    recipe: Mapping[str, Any] = field(default_factory=dict)
    crop: tuple[int, int] | None = None
    init: str | None = None
    teacher: str | None = None
    processes: int = 1
    step: int | None = None

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Read the facts of a file of any release; missing fields get their defaults.

        Raises:
            ValueError: if the height is not a valid image height.
        """
        facts = {key: values[key] for key in cls.__dataclass_fields__ if key in values}
        if facts.get("trained_height") is not None:
            check_side(facts["trained_height"], "trained_height")
        if not isinstance(facts.get("recipe"), Mapping):
            facts["recipe"] = {}
        return cls(**{**facts, "data": tuple(facts.get("data", ()))})

    def to_dict(self) -> dict[str, Any]:
        """Return the facts as plain values."""
        return {**asdict(self), "data": list(self.data)}

    @property
    def classes(self) -> str | tuple[ClassInfo, ...]:
        """The class table of the recipe: a name in `models.CLASS_TABLES`, or its own table."""
        table = self.recipe.get("model", {}).get("classes", "camvid")
        if isinstance(table, str):
            return table
        return tuple(ClassInfo(info["name"], tuple(info["color"])) for info in table)
