"""The whole loss, Eq. 12."""

from collections.abc import Collection, Mapping
from dataclasses import field
from functools import partial
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from models import NetworkOutput
from training.limits import STRICT, NotNegative
from training.loading.mixture import Batch, Pair
from training.losses.boundary import (
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
from training.losses.masked import cell_side, on_grid
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


class Term(NamedTuple):
    """Requirements of a term: heads of the network and, optionally, a target."""

    heads: frozenset[str]
    target: str = ""


#: The terms, each with a weight "<name>_weight" in `LossConfig`.
TERMS: Mapping[str, Term] = {
    "depth": Term(frozenset({"depth"}), "depth"),
    "depth_uncertainty": Term(frozenset({"depth", "depth_uncertainty"}), "depth"),
    "semantic": Term(frozenset({"semantic"}), "semantic"),
    "semantic_iou": Term(frozenset({"semantic"}), "semantic"),
    "lovasz": Term(frozenset({"semantic"}), "semantic"),
    "road": Term(frozenset({"semantic"}), "road_mask"),
    "boundary": Term(frozenset({"boundary"}), "semantic"),
    "semantic_boundary": Term(frozenset({"semantic", "boundary"}), "semantic"),
    "semantic_depth": Term(frozenset({"semantic", "depth"}), "semantic"),
    "depth_consistency": Term(frozenset({"depth"})),
    "depth_seam": Term(frozenset({"depth"})),
    "semantic_consistency": Term(frozenset({"semantic"})),
    "distilled_semantic": Term(frozenset({"semantic"})),
    "distilled_depth": Term(frozenset({"depth"})),
    "distilled_boundary": Term(frozenset({"boundary"})),
}
#: Terms that compare two views of each frame.
PAIR_TERMS = frozenset({"depth_consistency", "depth_seam", "semantic_consistency"})


@dataclass(frozen=True, config=STRICT)
class LossConfig:
    """The options of the loss. The defaults are our reading of the paper.

    A term of weight 0 is not computed: SSDNet_ind is `semantic_boundary_weight` and
    `semantic_depth_weight` 0.

    Raises:
        ValueError: for a negative number, for a weight of an unknown head, or if all weights are 0.
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

    @property
    def weighs_classes(self) -> bool:
        """Whether a term uses class weights."""
        return bool(self.semantic_weight) and self.class_weighting != "none"

    def terms_for(self, heads: Collection[str]) -> list[str]:
        """Return the names of the terms with a weight whose heads the network has.

        Terms of missing heads are skipped whatever their weight: one recipe trains the whole
        family.
        """
        of_paper = [name for name, term in TERMS.items() if term.heads <= set(heads)]
        others = [name for name in heads if name in HEAD_LOSSES]
        return [name for name in (*of_paper, *others) if self.weight(name)]

    def targets_for(self, heads: Collection[str]) -> tuple[str, ...]:
        """Return the names of the targets that the terms of these heads need."""
        needed = {self.target_of(name) for name in self.terms_for(heads)}
        return tuple(sorted(needed - {""}))

    def target_of(self, name: str) -> str:
        """Return the target of a term or of another head's loss, "" for none."""
        return TERMS[name].target if name in TERMS else name

    def heads_of(self, name: str) -> frozenset[str]:
        """Return the heads that a term or another head's loss compares."""
        return TERMS[name].heads if name in TERMS else frozenset({name})

    def taught_heads(self, heads: Collection[str]) -> list[str]:
        """Return the heads that learn from a teacher."""
        names = self.terms_for(heads)
        return [head for head in heads if f"distilled_{head}" in names]

    def weight(self, name: str) -> float:
        """Return the weight of a term or of another head's loss."""
        if name not in TERMS:
            return self.head_weights.get(name, 1.0)
        weight: float = getattr(self, f"{name}_weight")
        return weight

    def __post_init__(self) -> None:
        """Check the heads that are named, and that at least one weight is positive."""
        if unknown := sorted(self.head_weights.keys() - HEAD_LOSSES.keys()):
            known = ", ".join(sorted(HEAD_LOSSES)) or "none"
            raise ValueError(
                f"head_weights.{unknown[0]}: no head with a loss in training.losses.heads; heads "
                f"there: {known}"
            )
        if not any(self.weight(name) for name in (*TERMS, *HEAD_LOSSES)):
            raise ValueError("semantic_weight and all other weights are 0; nothing would learn")


class SSDNetLoss(nn.Module):
    """Eq. 12: the weighted sum of the losses of every task and of the joint ones, all means.

    Args:
        config: the options.
        class_weights: float (C,), see `training.losses.class_weights`; None = all 1.
        max_depth_m: depth [m] of the network's normalised output 1.0.
        target_depth_m: see `models.NetworkConfig`; None = ``max_depth_m``.
        road: id of the class of the road masks; None = no such class.
    """

    class_weights: Tensor | None
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
        self.register_buffer("class_weights", class_weights, persistent=False)
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
            batch: the frames. Depth that is not finite or beyond ``target_depth_m`` is unknown; the
                weights of "semantic" are those in Eq. 5 and 6.

        Returns:
            Terms by their names in `TERMS` or `HEAD_LOSSES`, without those of weight 0, of missing
            heads and of targets that the batch does not have.
        """
        height, width = batch.rgb.shape[-2:]
        terms: dict[str, Tensor] = {}
        if "semantic" in batch.targets:
            semantic, weights = batch.targets["semantic"].long(), batch.weights["semantic"]
            terms |= self._boundary_terms(output, semantic, weights)
            terms |= self._semantic_terms(output, semantic, weights)
        if "depth" in batch.targets:
            terms |= self._depth_terms(output, batch.targets["depth"].unsqueeze(1))
        terms |= self._road_terms(output, batch.targets.get("road_mask"))
        if batch.pair is not None:
            terms |= self._pair_terms(output, batch.pair, (height, width))
        if batch.teacher is not None:
            terms |= self._distilled_terms(output, batch.teacher)
        for head in output.others.keys() & HEAD_LOSSES.keys() & batch.targets.keys():
            if self.config.weight(head):
                answers = output.others[head].float()
                terms[head] = HEAD_LOSSES[head](answers, batch.targets[head], batch.weights[head])
        weighted = [self._weigh(name, term) for name, term in terms.items()]
        # Without any term the total is 0, with a gradient of 0.
        anchor = torch.nan_to_num(_any_answer(output)[0, 0, 0, 0].float(), posinf=0, neginf=0)
        terms["total"] = sum(weighted, start=0.0 * anchor)
        return terms

    def _weigh(self, name: str, term: Tensor) -> Tensor:
        weighted = self.config.weight(name) * term
        if name not in self.log_variances:
            return weighted
        log_variance = self.log_variances[name]
        share = 0.5 if name == "depth" else 1.0
        known = (term.detach() != 0).to(term.dtype)  # a term without targets is exactly 0
        total: Tensor = share * torch.exp(-log_variance) * weighted + 0.5 * log_variance * known
        return total

    def _boundary_terms(
        self, output: NetworkOutput, semantic: Tensor, semantic_weight: Tensor | None
    ) -> dict[str, Tensor]:
        logits = output.boundary_logits
        if logits is None or not self.config.boundary_weight:
            return {}
        target = boundary_at_scale(*boundary_target(semantic), (logits.shape[-2], logits.shape[-1]))
        loss = balanced_cross_entropy(logits.float(), *target, sample_weight=semantic_weight)
        return {"boundary": loss}

    def _depth_terms(self, output: NetworkOutput, depth: Tensor) -> dict[str, Tensor]:
        config = self.config
        if output.depths is None or not (config.depth_weight or config.depth_uncertainty_weight):
            return {}
        farthest = self.target_depth_m / self.max_depth_m
        criterion: DepthCriterion = paper_depth_loss
        if config.depth_form == "metric":
            criterion = partial(
                metric_depth_loss,
                max_depth_m=self.max_depth_m,
                l2=config.metric_l2,
                log=config.metric_log,
                farthest=farthest,
            )
        scales = output.depths if config.depth_scales == "mean" else output.depths[:1]
        target, valid = normalise_depth(depth, self.max_depth_m, self.target_depth_m)
        terms = {}
        if config.depth_weight:
            terms["depth"] = multi_scale_depth_loss(scales, target, valid, criterion)
        if config.depth_uncertainty_weight and output.depth_uncertainty is not None:
            terms["depth_uncertainty"] = laplace_loss(
                output.depth_uncertainty.float(),
                output.depths[0].float(),
                target,
                # Sky targets at the far end of the range are not measured.
                valid & (target < farthest),
                max_depth_m=self.max_depth_m,
            )
        return terms

    def _pair_terms(
        self, output: NetworkOutput, pair: Pair, size: tuple[int, int]
    ) -> dict[str, Tensor]:
        config = self.config
        terms: dict[str, Tensor] = {}
        if output.depths is not None:
            first, second = output.depths[0].float().chunk(2)
            if config.depth_consistency_weight:
                terms["depth_consistency"] = depth_consistency_loss(first, second, pair)
            if config.depth_seam_weight:
                terms["depth_seam"] = depth_seam_loss(first, second, pair)
        if config.semantic_consistency_weight and output.semantic_logits is not None:
            logits = output.semantic_logits.float()
            side = cell_side(size, (logits.shape[-2], logits.shape[-1]))
            first, second = logits.chunk(2)
            loss = semantic_consistency_loss(first, second, pair, side=side)
            terms["semantic_consistency"] = loss
        return terms

    def _distilled_terms(self, output: NetworkOutput, teacher: NetworkOutput) -> dict[str, Tensor]:
        config = self.config
        terms: dict[str, Tensor] = {}
        classes, wanted = output.semantic_logits, teacher.semantic_logits
        if config.distilled_semantic_weight and classes is not None and wanted is not None:
            terms["distilled_semantic"] = distilled_semantic_loss(classes.float(), wanted.float())
        if config.distilled_depth_weight and output.depths is not None and teacher.depths:
            depth, wanted = output.depths[0].float(), teacher.depths[0].float()
            terms["distilled_depth"] = distilled_depth_loss(
                depth, wanted, teacher.depth_uncertainty
            )
        boundary, wanted = output.boundary_logits, teacher.boundary_logits
        if config.distilled_boundary_weight and boundary is not None and wanted is not None:
            terms["distilled_boundary"] = distilled_boundary_loss(boundary.float(), wanted.float())
        return terms

    def _road_terms(self, output: NetworkOutput, road_mask: Tensor | None) -> dict[str, Tensor]:
        logits = output.semantic_logits
        if logits is None or road_mask is None or self.road is None or not self.config.road_weight:
            return {}
        return {"road": road_loss(logits.float(), road_mask, self.road)}

    def _semantic_terms(
        self, output: NetworkOutput, semantic: Tensor, sample_weight: Tensor
    ) -> dict[str, Tensor]:
        config, logits = self.config, output.semantic_logits
        if logits is None:
            return {}
        boundary = output.boundary_logits if config.semantic_boundary_weight else None
        depths = output.depths if config.semantic_depth_weight else None
        grid = (logits.shape[-2], logits.shape[-1])
        log_probabilities = F.log_softmax(logits.float(), dim=1)
        probabilities = log_probabilities.exp()
        shares = class_shares(semantic, logits.shape[1], grid)
        terms = {}
        if config.semantic_iou_weight:
            terms["semantic_iou"] = soft_iou_loss(probabilities, shares, sample_weight)
        if config.lovasz_weight:
            pictures = zip(probabilities, semantic, strict=True)
            losses = [lovasz_softmax_loss(_over_pixels(p, label), label) for p, label in pictures]
            known = semantic != IGNORE
            terms["lovasz"] = picture_mean(torch.stack(losses), known, sample_weight)
        if config.semantic_weight:
            terms["semantic"] = weighted_cross_entropy(
                log_probabilities, shares, self.class_weights, sample_weight
            )
        if boundary is None and depths is None:
            return terms
        if config.disagreement == "soft":
            disagreement = soft_disagreement(probabilities)
        else:
            disagreement = hard_disagreement(log_probabilities.argmax(dim=1))
        side = cell_side((semantic.shape[-2], semantic.shape[-1]), grid)
        if boundary is not None:
            terms["semantic_boundary"] = semantic_boundary_loss(
                disagreement, on_grid(torch.sigmoid(boundary.float()), grid), side=side
            )
        if depths is not None:
            depth = on_grid(depths[0].float(), grid)
            terms["semantic_depth"] = semantic_depth_loss(disagreement, depth, side=side)
        return terms


def _any_answer(output: NetworkOutput) -> Tensor:
    """Return the output of any head, (N, any, h, w)."""
    depth = None if output.depths is None else output.depths[0]
    for answer in (output.boundary_logits, output.semantic_logits, depth, *output.others.values()):
        if answer is not None:
            return answer
    raise ValueError("the network has no head")


def _over_pixels(cells: Tensor, semantic: Tensor) -> Tensor:
    """Repeat (C, h, w) over the pixels of every cell: (C, H, W), of the size of ``semantic``."""
    height, width = semantic.shape
    side = cell_side((height, width), (cells.shape[-2], cells.shape[-1]))
    if side == 1:
        return cells
    pixels = cells.repeat_interleave(side, dim=1).repeat_interleave(side, dim=2)
    return pixels[:, :height, :width]
