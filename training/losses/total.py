"""The whole loss, Eq. 12."""

from collections.abc import Collection, Mapping
from dataclasses import field
from typing import Annotated, Any, Literal

import torch
from pydantic import AfterValidator, model_validator
from pydantic.dataclasses import dataclass
from pydantic_core import ArgsKwargs
from torch import Tensor, nn

from models import NetworkOutput
from runtime.base.errors import InputError
from training.base.limits import STRICT, NotNegative
from training.base.own_code import named_errors
from training.loading.batch import Batch
from training.losses.semantic import ClassWeighting
from training.losses.terms import TERMS, Compared, Term, find_term, list_terms


def gather_weights(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table of `LossConfig` whose weights are all in `weights`.

    Recipes and checkpoints of earlier releases name them `NAME_weight`, and those of other heads
    `head_weights`.
    """
    earlier = {f"{name}_weight": name for name in TERMS}
    gathered = {k: v for k, v in table.items() if k not in earlier and k != "head_weights"}
    heads = table.get("head_weights") or {}
    weights = {earlier[key]: value for key, value in table.items() if key in earlier}
    if weights or heads:
        gathered["weights"] = {**table.get("weights", {}), **heads, **weights}
    return gathered


def _complete(weights: Mapping[str, float]) -> dict[str, float]:
    """Return the weight of every term; ValueError for a name that is no term."""
    if unknown := [name for name in weights if find_term(name) is None]:
        raise ValueError(f"{unknown[0]}: unknown term; known: {', '.join(list_terms())}")
    return {**{name: term.weight for name, term in TERMS.items()}, **weights}


@dataclass(frozen=True, config=STRICT)
class LossConfig:
    """The options of the loss. The defaults are our reading of the paper.

    docs/network.md has the equations of the paper, their keys and what differs from them.

    Attributes:
        weights: weight of each term, see `training.losses.terms`; a term that is missing here has
            the weight of the table there. A term of weight 0 is not computed: for SSDNet_ind,
            semantic_boundary and semantic_depth are 0.
        weighting: "fixed": the weights above, as in the paper. "uncertainty": each weight except
            that of "depth_uncertainty" is multiplied by a learned factor (Kendall et al. 2018, the
            paper's reference 35).
        semantic_grid: where the semantic loss is computed: at the image's size, or on the head's
            own grid against the share of each class among the pixels of a cell, which is faster.
            Both are the same for a head at the image's size.
        class_weighting: how the class frequencies give Eq. 5's beta; "paper" is literal.
        depth_form: "paper": Eq. 4 on normalised depth. "metric": L1 + metric_l2 * L2 in metres, and
            ratios.
        metric_log: weight of the mean |log(prediction / target)| beside them [m].
        depth_scales: whether the loss is the mean over all scales, or that of the finest scale.
        disagreement: whether Eq. 7 is on probabilities, or as printed on arg-max labels (no
            gradient to the semantic head).

    Raises:
        ValueError: for a negative number, or for the weight of an unknown term.
    """

    weights: Annotated[Mapping[str, NotNegative], AfterValidator(_complete)] = field(
        default_factory=lambda: _complete({})
    )

    weighting: Literal["fixed", "uncertainty"] = "fixed"

    semantic_grid: Literal["image", "head"] = "image"

    class_weighting: ClassWeighting = "median"

    depth_form: Literal["paper", "metric"] = "paper"
    metric_l2: NotNegative = 0.02
    metric_log: NotNegative = 0.0
    depth_scales: Literal["mean", "finest"] = "mean"

    disagreement: Literal["soft", "hard"] = "soft"

    @model_validator(mode="before")
    @classmethod
    def _read_earlier_keys(cls, given: Any) -> Any:
        if isinstance(given, ArgsKwargs):
            return ArgsKwargs(given.args, gather_weights(given.kwargs or {}))
        return gather_weights(given) if isinstance(given, Mapping) else given

    def terms_for(self, heads: Collection[str]) -> dict[str, Term]:
        """Return the terms with a weight whose heads the network has, by name.

        Terms of missing heads are skipped whatever their weight: one recipe trains the whole
        family. A head whose name is a term has this term, also if the recipe does not name it.
        """
        names = dict.fromkeys((*self.weights, *heads))
        terms = {name: term for name in names if (term := find_term(name)) is not None}
        return {
            name: term
            for name, term in terms.items()
            if term.heads <= set(heads) and self.weight(name)
        }

    def taught_heads(self, heads: Collection[str]) -> list[str]:
        """Return the heads that learn from a teacher."""
        terms = self.terms_for(heads)
        return [head for head in heads if f"distilled_{head}" in terms]

    def weight(self, name: str) -> float:
        """Return the weight of a term."""
        term = find_term(name)
        return self.weights.get(name, 0.0 if term is None else term.weight)


def _compute(name: str, term: Term, compared: Compared) -> Tensor:
    """Return a term; InputError that names it, if it fails or is no mean over the batch."""
    with named_errors(f"the loss term {name!r}"):
        value = term.loss(compared)
    if not isinstance(value, Tensor) or value.shape or not value.is_floating_point():
        kind = f"{value.dtype} {tuple(value.shape)}" if isinstance(value, Tensor) else type(value)
        raise InputError(
            f"the loss term {name!r} returned {kind}; expected a mean over the batch, one number "
            "of a floating type: return loss.mean()"
        )
    return value


class SSDNetLoss(nn.Module):
    """Eq. 12: the weighted sum of the losses of every task and of the joint ones, all means.

    Args:
        config: the options.
        class_weights: float (C,), see `training.losses.class_weights`; None: all 1.
        max_depth_m: depth [m] of the network's normalised output 1.0.
        unmeasured_range_m: see `models.NetworkConfig`.
        road: id of the class of the road masks; None: no such class.

    Attributes:
        log_variances: log sigma^2 of each term, learned if the weighting is "uncertainty".
    """

    class_weights: Tensor
    log_variances: nn.ParameterDict

    def __init__(
        self,
        config: LossConfig,
        class_weights: Tensor | None,
        *,
        max_depth_m: float,
        unmeasured_range_m: float,
        road: int | None,
    ) -> None:
        super().__init__()
        self.config = config
        self.road = road
        self.max_depth_m = max_depth_m
        self.unmeasured_range_m = unmeasured_range_m
        # The same, normalised; also the depth of the sky.
        self.unmeasured_share = self.unmeasured_range_m / max_depth_m
        weights = torch.ones(()) if class_weights is None else class_weights
        self.register_buffer("class_weights", weights, persistent=False)
        # A negative log likelihood may be negative: its learned weight would diverge.
        names = [name for name, value in config.weights.items() if value]
        learned = names if config.weighting == "uncertainty" else []
        self.log_variances = nn.ParameterDict(
            {name: nn.Parameter(torch.zeros(())) for name in learned if name != "depth_uncertainty"}
        )

    def forward(self, output: NetworkOutput, batch: Batch) -> dict[str, Tensor]:
        """Return every term by name, not yet weighted, and their weighted sum as "total"; all ().

        With the weighting "uncertainty" a term L counts as weight * L / sigma^2 + log sigma, the
        depth with half of the first part (a regression: Kendall et al. 2018, Eq. 5 and 10); a term
        without targets in the batch does not change its sigma. Computed in float32 whatever the
        network's precision.

        Args:
            output: of `Network.forward`.
            batch: the frames, with the targets of all terms. Depth that is not finite or beyond
                `unmeasured_range_m` is unknown; the weights of "semantic" are those in Eq. 5 and 6.

        Returns:
            Terms by their names, without those of weight 0 and of missing heads.
        """
        compared = Compared(self, output, batch)
        wanted = self.config.terms_for(compared.heads)
        terms = {name: _compute(name, term, compared) for name, term in wanted.items()}
        weighted = [self._weigh(name, term) for name, term in terms.items()]
        return {**terms, "total": torch.stack(weighted).sum()}

    def _weigh(self, name: str, term: Tensor) -> Tensor:
        weighted = self.config.weight(name) * term
        if name not in self.log_variances:
            return weighted
        log_variance = self.log_variances[name]
        share = 0.5 if name == "depth" else 1.0
        known = (term.detach() != 0).to(term.dtype)  # a term without targets is exactly 0
        total: Tensor = share * torch.exp(-log_variance) * weighted + 0.5 * log_variance * known
        return total
