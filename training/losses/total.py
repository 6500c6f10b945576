"""The whole loss, Eq. 12."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import field
from functools import cached_property, partial
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from models import NetworkOutput
from models.answers import head_maps
from training.limits import STRICT, NotNegative
from training.loading.mixture import Batch, Pair
from training.losses.boundary import (
    NeighbourMaps,
    balanced_cross_entropy,
    boundary_at_scale,
    boundary_target,
    hard_disagreement,
    semantic_boundary_loss,
    semantic_depth_loss,
    soft_disagreement,
)
from training.losses.consistency import (
    depth_consistency_loss,
    depth_seam_loss,
    semantic_consistency_loss,
)
from training.losses.depth import (
    DepthCriterion,
    laplace_loss,
    metric_depth_loss,
    multi_scale_depth_loss,
    normalise_depth,
    paper_depth_loss,
)
from training.losses.distillation import (
    distilled_boundary_loss,
    distilled_depth_loss,
    distilled_semantic_loss,
)
from training.losses.heads import HEAD_LOSSES
from training.losses.masked import cell_side, grid_of, on_grid
from training.losses.semantic import (
    IGNORE,
    ClassWeighting,
    class_shares,
    lovasz_softmax_loss,
    picture_mean,
    road_loss,
    soft_iou_loss,
    weighted_cross_entropy,
)


class Compared:
    """A network's output beside the batch that it answers, and what several terms share.

    Attributes:
        heads: head -> float32 (N, C, h, w), see `models.answers.head_maps`.
        depths: of all scales, the finest first.
    """

    def __init__(self, loss: "SSDNetLoss", output: NetworkOutput, batch: Batch) -> None:
        self.loss, self.config, self.batch = loss, loss.config, batch
        self.heads = _float_maps(output)
        self.depths = tuple(depth.float() for depth in output.depths or ())

    @cached_property
    def labels(self) -> Tensor:
        """Class ids, int64 (N, H, W)."""
        return self.batch.targets["semantic"].long()

    @property
    def label_weights(self) -> Tensor:
        """The weight of each frame's labels, (N,)."""
        return self.batch.weights["semantic"]

    @cached_property
    def log_probabilities(self) -> Tensor:
        """Of the classes, (N, C, h, w)."""
        return F.log_softmax(self.heads["semantic"], dim=1)

    @cached_property
    def probabilities(self) -> Tensor:
        """Of the classes, (N, C, h, w)."""
        return self.log_probabilities.exp()

    @cached_property
    def shares(self) -> Tensor:
        """See `class_shares`, on the grid of the classes."""
        logits = self.heads["semantic"]
        return class_shares(self.labels, logits.shape[1], grid_of(logits))

    @cached_property
    def disagreement(self) -> NeighbourMaps:
        """Eq. 7, on the grid of the classes."""
        if self.config.disagreement == "soft":
            return soft_disagreement(self.probabilities)
        return hard_disagreement(self.log_probabilities.argmax(dim=1))

    @cached_property
    def depth_target(self) -> tuple[Tensor, Tensor]:
        """See `normalise_depth`."""
        depth = self.batch.targets["depth"].unsqueeze(1)
        return normalise_depth(depth, self.loss.max_depth_m, self.loss.target_depth_m)

    @cached_property
    def taught(self) -> dict[str, Tensor]:
        """The teacher's heads."""
        assert self.batch.teacher is not None
        return _float_maps(self.batch.teacher)

    @property
    def side(self) -> int:
        """Side of a cell of the classes [px]."""
        return cell_side(grid_of(self.batch.rgb), grid_of(self.heads["semantic"]))

    def on_classes(self, values: Tensor) -> Tensor:
        """Return (N, 1, H, W) on the grid of the classes."""
        return on_grid(values, grid_of(self.heads["semantic"]))

    def views(self, head: str) -> tuple[Tensor, Tensor, Pair]:
        """Return a head's answers for the first and for the second views, and how these differ."""
        assert self.batch.pair is not None
        first, second = self.heads[head].chunk(2)
        return first, second, self.batch.pair


def _float_maps(output: NetworkOutput) -> dict[str, Tensor]:
    return {head: values.float() for head, values in head_maps(output).items()}


def _depth(c: Compared) -> Tensor:
    criterion: DepthCriterion = paper_depth_loss
    if c.config.depth_form == "metric":
        criterion = partial(
            metric_depth_loss,
            max_depth_m=c.loss.max_depth_m,
            l2=c.config.metric_l2,
            log=c.config.metric_log,
            farthest=c.loss.farthest,
        )
    scales = c.depths if c.config.depth_scales == "mean" else c.depths[:1]
    return multi_scale_depth_loss(scales, *c.depth_target, criterion)


def _depth_uncertainty(c: Compared) -> Tensor:
    target, valid = c.depth_target
    # Sky targets at the far end of the range are not measured.
    measured = valid & (target < c.loss.farthest)
    scale, max_depth_m = c.heads["depth_uncertainty"], c.loss.max_depth_m
    return laplace_loss(scale, c.heads["depth"], target, measured, max_depth_m=max_depth_m)


def _semantic(c: Compared) -> Tensor:
    weights = c.loss.class_weights
    return weighted_cross_entropy(c.log_probabilities, c.shares, weights, c.label_weights)


def _semantic_iou(c: Compared) -> Tensor:
    return soft_iou_loss(c.probabilities, c.shares, c.label_weights)


def _lovasz(c: Compared) -> Tensor:
    side, (height, width) = c.side, grid_of(c.labels)
    cells = c.probabilities
    if side > 1:  # every pixel of a cell has its probabilities
        cells = cells.repeat_interleave(side, dim=2).repeat_interleave(side, dim=3)
    pictures = zip(cells[..., :height, :width], c.labels, strict=True)
    losses = torch.stack([lovasz_softmax_loss(*picture) for picture in pictures])
    return picture_mean(losses, c.labels != IGNORE, c.label_weights)


def _road(c: Compared) -> Tensor:
    assert c.loss.road is not None
    return road_loss(c.heads["semantic"], c.batch.targets["road_mask"], c.loss.road)


def _boundary(c: Compared) -> Tensor:
    logits = c.heads["boundary"]
    target, valid = boundary_at_scale(*boundary_target(c.labels), grid_of(logits))
    return balanced_cross_entropy(logits, target, valid, c.label_weights)


def _semantic_boundary(c: Compared) -> Tensor:
    boundary = c.on_classes(torch.sigmoid(c.heads["boundary"]))
    return semantic_boundary_loss(c.disagreement, boundary, side=c.side)


def _semantic_depth(c: Compared) -> Tensor:
    return semantic_depth_loss(c.disagreement, c.on_classes(c.heads["depth"]), side=c.side)


def _semantic_consistency(c: Compared) -> Tensor:
    return semantic_consistency_loss(*c.views("semantic"), side=c.side)


def _distilled_semantic(c: Compared) -> Tensor:
    return distilled_semantic_loss(c.heads["semantic"], c.taught["semantic"])


def _distilled_boundary(c: Compared) -> Tensor:
    return distilled_boundary_loss(c.heads["boundary"], c.taught["boundary"])


def _distilled_depth(c: Compared) -> Tensor:
    scale = c.taught.get("depth_uncertainty")
    return distilled_depth_loss(c.heads["depth"], c.taught["depth"], scale)


class Term(NamedTuple):
    """A term: its loss, and what it requires: heads of the network and, optionally, a target."""

    heads: frozenset[str]
    target: str
    loss: Callable[[Compared], Tensor]


#: The terms, each with a weight "<name>_weight" in `LossConfig`: heads, target, loss.
TERMS: Mapping[str, Term] = {
    name: Term(frozenset(heads.split()), target, loss)
    for name, heads, target, loss in (
        ("depth", "depth", "depth", _depth),
        ("depth_uncertainty", "depth depth_uncertainty", "depth", _depth_uncertainty),
        ("semantic", "semantic", "semantic", _semantic),
        ("semantic_iou", "semantic", "semantic", _semantic_iou),
        ("lovasz", "semantic", "semantic", _lovasz),
        ("road", "semantic", "road_mask", _road),
        ("boundary", "boundary", "semantic", _boundary),
        ("semantic_boundary", "semantic boundary", "semantic", _semantic_boundary),
        ("semantic_depth", "semantic depth", "semantic", _semantic_depth),
        ("depth_consistency", "depth", "", lambda c: depth_consistency_loss(*c.views("depth"))),
        ("depth_seam", "depth", "", lambda c: depth_seam_loss(*c.views("depth"))),
        ("semantic_consistency", "semantic", "", _semantic_consistency),
        ("distilled_semantic", "semantic", "", _distilled_semantic),
        ("distilled_depth", "depth", "", _distilled_depth),
        ("distilled_boundary", "boundary", "", _distilled_boundary),
    )
}


def _term_of_head(head: str) -> Term:
    """Return the term of a head with a loss in `training.losses.heads`."""

    def loss(c: Compared) -> Tensor:
        return HEAD_LOSSES[head](c.heads[head], c.batch.targets[head], c.batch.weights[head])

    return Term(frozenset({head}), head, loss)


#: Keys of `LossConfig` that leave the terms of depth alone.
DEPTH_ALONE = {f"{name}_weight": 0.0 for name in TERMS if not name.startswith("depth")}
#: Terms that compare two views of each frame.
PAIR_TERMS = frozenset({"depth_consistency", "depth_seam", "semantic_consistency"})


@dataclass(frozen=True, config=STRICT)
class LossConfig:
    """The options of the loss. The defaults are our reading of the paper.

    A term of weight 0 is not computed: SSDNet_ind is `semantic_boundary_weight` and
    `semantic_depth_weight` 0.

    Raises:
        ValueError: for a negative number, or for a weight of an unknown head.
    """

    #: One weight a term of Eq. 12: Eq. 4, 5, 6, 8, 11.
    #: 1 is Eq. 12 as printed; with the soft form of Eq. 8 and 11 training then often collapses to
    #: one class, and 0.03 is used instead (docs/results.md).
    depth_weight: NotNegative = 1.0
    semantic_weight: NotNegative = 1.0
    boundary_weight: NotNegative = 1.0
    semantic_boundary_weight: NotNegative = 1.0
    semantic_depth_weight: NotNegative = 1.0
    #: Soft IoU of the classes beside Eq. 5; not the paper's.
    semantic_iou_weight: NotNegative = 0.0
    #: Lovász-Softmax of each picture (Berman et al. 2018); ENet with it is the paper's ENet_LSloss.
    lovasz_weight: NotNegative = 0.0
    #: The class "road" against road masks, of sets without other labels; not the paper's.
    road_weight: NotNegative = 0.0
    #: Likelihood of the depth's errors under the predicted uncertainty.
    depth_uncertainty_weight: NotNegative = 0.1
    #: Agreement of two shifted views of each frame, see `training.losses.consistency`.
    depth_consistency_weight: NotNegative = 0.0
    depth_seam_weight: NotNegative = 0.0
    semantic_consistency_weight: NotNegative = 0.0
    #: Agreement with the answers of a teacher, see `training.losses.distillation`.
    distilled_semantic_weight: NotNegative = 0.0
    distilled_depth_weight: NotNegative = 0.0
    distilled_boundary_weight: NotNegative = 0.0

    #: Weight of the loss of each head in `training.losses.heads`; 1 where none is here.
    head_weights: Mapping[str, NotNegative] = field(default_factory=dict)

    #: "fixed": the weights above, as in the paper. "uncertainty": each but that of
    #: "depth_uncertainty" is multiplied by a learned factor (Kendall et al. 2018, the paper's
    #: reference 35).
    weighting: Literal["fixed", "uncertainty"] = "fixed"

    #: Where the semantic loss is computed: at the image's size, or on the head's own grid against
    #: the share of each class among the pixels of a cell, which is faster. The same for a head at
    #: the image's size.
    semantic_grid: Literal["image", "head"] = "image"

    #: How Eq. 5's beta comes from the class frequencies; "paper" is literal.
    class_weighting: ClassWeighting = "median"

    #: "paper": Eq. 4 on normalised depth. "metric": L1 + metric_l2 * L2 in metres, and ratios.
    depth_form: Literal["paper", "metric"] = "paper"
    metric_l2: NotNegative = 0.02
    #: Weight of the mean |log(prediction / target)| beside them [m].
    metric_log: NotNegative = 0.0
    #: Mean over all scales, or the finest alone.
    depth_scales: Literal["mean", "finest"] = "mean"

    #: Eq. 7 on probabilities, or as printed on arg-max labels (no gradient to the semantic head).
    disagreement: Literal["soft", "hard"] = "soft"

    def terms_for(self, heads: Collection[str]) -> dict[str, Term]:
        """Return the terms with a weight whose heads the network has, by name.

        Terms of missing heads are skipped whatever their weight: one recipe trains the whole
        family.
        """
        terms = {name: term for name, term in TERMS.items() if term.heads <= set(heads)}
        terms |= {head: _term_of_head(head) for head in heads if head in HEAD_LOSSES}
        return {name: term for name, term in terms.items() if self.weight(name)}

    def taught_heads(self, heads: Collection[str]) -> list[str]:
        """Return the heads that learn from a teacher."""
        terms = self.terms_for(heads)
        return [head for head in heads if f"distilled_{head}" in terms]

    def weight(self, name: str) -> float:
        """Return the weight of a term or of another head's loss."""
        if name not in TERMS:
            return self.head_weights.get(name, 1.0)
        weight: float = getattr(self, f"{name}_weight")
        return weight

    def __post_init__(self) -> None:
        """Check the heads that are named."""
        if unknown := sorted(self.head_weights.keys() - HEAD_LOSSES.keys()):
            known = ", ".join(sorted(HEAD_LOSSES)) or "none"
            raise ValueError(
                f"head_weights.{unknown[0]}: no head with a loss in training.losses.heads; heads "
                f"there: {known}"
            )


class SSDNetLoss(nn.Module):
    """Eq. 12: the weighted sum of the losses of every task and of the joint ones, all means.

    Args:
        config: the options.
        class_weights: float (C,), see `training.losses.class_weights`; None = all 1.
        max_depth_m: depth [m] of the network's normalised output 1.0.
        target_depth_m: see `models.NetworkConfig`; None = ``max_depth_m``.
        road: id of the class of the road masks; None = no such class.
    """

    class_weights: Tensor
    #: log sigma^2 of each term, learned if the weighting is "uncertainty".
    log_variances: nn.ParameterDict

    def __init__(
        self,
        config: LossConfig,
        class_weights: Tensor | None = None,
        *,
        max_depth_m: float,
        target_depth_m: float | None = None,
        road: int | None = None,
    ) -> None:
        super().__init__()
        self.config = config
        self.road = road
        self.max_depth_m = max_depth_m
        self.target_depth_m = target_depth_m or max_depth_m
        #: Normalised depth of the sky.
        self.farthest = self.target_depth_m / max_depth_m
        weights = torch.ones(()) if class_weights is None else class_weights
        self.register_buffer("class_weights", weights, persistent=False)
        # A negative log likelihood may be negative: its learned weight would diverge.
        names = [name for name in (*TERMS, *HEAD_LOSSES) if name != "depth_uncertainty"]
        learned = names if config.weighting == "uncertainty" else []
        self.log_variances = nn.ParameterDict(
            {name: nn.Parameter(torch.zeros(())) for name in learned if config.weight(name)}
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
                ``target_depth_m`` is unknown; the weights of "semantic" are those in Eq. 5 and 6.

        Returns:
            Terms by their names in `TERMS` or `HEAD_LOSSES`, without those of weight 0 and of
            missing heads.
        """
        compared = Compared(self, output, batch)
        wanted = self.config.terms_for(compared.heads)
        terms = {name: term.loss(compared) for name, term in wanted.items()}
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
