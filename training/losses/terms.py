"""The terms of the loss: one table says what each requires, how it is computed and its weight."""

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from models import NetworkOutput
from models.answers import head_maps
from runtime.base.entry_points import find_entry, list_entries
from runtime.contract.contract import NO_CLASS
from training.loading.batch import Batch, Pair
from training.losses import agreement, boundary, depth, semantic
from training.losses.masked import cell_side, grid_of, on_grid

if TYPE_CHECKING:
    from training.losses.total import SSDNetLoss


class Compared:
    """A network's output beside its batch, with values that several terms share.

    Attributes:
        loss: the whole loss, which knows `max_depth_m` and `unmeasured_range_m` of the network,
            `class_weights` and the id of the class `road`.
        config: the options of the loss.
        batch: the frames, with the targets and their weights, see `Batch`.
        heads: float32 (N, C, h, w) of each head, see `models.answers.head_maps`.
        depths: depth at all scales, the finest first, (N, 1, h, w), shares of `max_depth_m`.
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
        """Log probabilities of the classes, (N, C, h, w)."""
        return F.log_softmax(self.heads["semantic"], dim=1)

    @cached_property
    def probabilities(self) -> Tensor:
        """Probabilities of the classes, (N, C, h, w)."""
        return self.log_probabilities.exp()

    @cached_property
    def labelled_log_probabilities(self) -> Tensor:
        """Log probabilities among the classes that the labels of a frame have, (N, C, h, w)."""
        if not any(self.batch.lacking):
            return self.log_probabilities
        logits = self.heads["semantic"]
        hidden = torch.zeros(logits.shape[:2], dtype=torch.bool, device=logits.device)
        for frame, classes in enumerate(self.batch.lacking):
            hidden[frame, list(classes)] = True
        # Finite, because a share of 0 times infinity is no number.
        return F.log_softmax(logits.masked_fill(hidden[..., None, None], -1e4), dim=1)

    @cached_property
    def shares(self) -> Tensor:
        """See `class_shares`, on the grid of the classes."""
        logits = self.heads["semantic"]
        return semantic.class_shares(self.labels, logits.shape[1], grid_of(logits))

    @cached_property
    def disagreement(self) -> boundary.NeighbourMaps:
        """Eq. 7, on the grid of the classes."""
        if self.config.disagreement == "soft":
            return boundary.soft_disagreement(self.probabilities)
        return boundary.hard_disagreement(self.log_probabilities.argmax(dim=1))

    @cached_property
    def depth_target(self) -> tuple[Tensor, Tensor]:
        """See `normalise_depth`."""
        metres = self.batch.targets["depth"].unsqueeze(1)
        return depth.normalise_depth(metres, self.loss.max_depth_m, self.loss.unmeasured_range_m)

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
    """Return the mean over the scales, each with its own truth; the paper gives no weights."""
    options = {
        "max_depth_m": c.loss.max_depth_m,
        "l2": c.config.metric_l2,
        "log": c.config.metric_log,
        "unmeasured_share": c.loss.unmeasured_share,
    }
    losses = []
    for prediction in c.depths if c.config.depth_scales == "mean" else c.depths[:1]:
        target, valid = depth.depth_at_scale(*c.depth_target, grid_of(prediction))
        if c.config.depth_form == "paper":
            losses.append(depth.paper_depth_loss(prediction, target, valid))
        else:
            losses.append(depth.metric_depth_loss(prediction, target, valid, **options))
    return torch.stack(losses).mean()


def _depth_uncertainty(c: Compared) -> Tensor:
    target, valid = c.depth_target
    # Sky targets at the far end of the range are not measured.
    measured = valid & (target < c.loss.unmeasured_share)
    scale, max_depth_m = c.heads["depth_uncertainty"], c.loss.max_depth_m
    return depth.laplace_loss(scale, c.heads["depth"], target, measured, max_depth_m=max_depth_m)


def _semantic(c: Compared) -> Tensor:
    weights = c.loss.class_weights
    log_probabilities = c.labelled_log_probabilities
    return semantic.weighted_cross_entropy(log_probabilities, c.shares, weights, c.label_weights)


def _semantic_iou(c: Compared) -> Tensor:
    return semantic.soft_iou_loss(c.labelled_log_probabilities.exp(), c.shares, c.label_weights)


def _lovasz(c: Compared) -> Tensor:
    side, (height, width) = c.side, grid_of(c.labels)
    cells = c.probabilities
    if side > 1:  # every pixel of a cell has its probabilities
        cells = cells.repeat_interleave(side, dim=2).repeat_interleave(side, dim=3)
    pictures = zip(cells[..., :height, :width], c.labels, strict=True)
    losses = torch.stack([semantic.lovasz_softmax_loss(*picture) for picture in pictures])
    labelled = (c.labels != NO_CLASS).flatten(1).any(dim=1).sum()
    return semantic.labelled_mean(losses, labelled, c.label_weights)


def _road(c: Compared) -> Tensor:
    assert c.loss.road is not None
    return semantic.road_loss(c.heads["semantic"], c.batch.targets["road_mask"], c.loss.road)


def _boundary(c: Compared) -> Tensor:
    logits = c.heads["boundary"]
    target, valid = boundary.boundary_at_scale(*boundary.boundary_target(c.labels), grid_of(logits))
    return boundary.balanced_cross_entropy(logits, target, valid, c.label_weights)


def _semantic_boundary(c: Compared) -> Tensor:
    answer = c.on_classes(torch.sigmoid(c.heads["boundary"]))
    return boundary.semantic_boundary_loss(c.disagreement, answer, side=c.side)


def _semantic_depth(c: Compared) -> Tensor:
    return boundary.semantic_depth_loss(c.disagreement, c.on_classes(c.heads["depth"]), side=c.side)


def _semantic_consistency(c: Compared) -> Tensor:
    return agreement.semantic_consistency_loss(*c.views("semantic"), side=c.side)


def _distilled_semantic(c: Compared) -> Tensor:
    return agreement.distilled_semantic_loss(c.heads["semantic"], c.taught["semantic"])


def _distilled_boundary(c: Compared) -> Tensor:
    return agreement.distilled_boundary_loss(c.heads["boundary"], c.taught["boundary"])


def _distilled_depth(c: Compared) -> Tensor:
    scale = c.taught.get("depth_uncertainty")
    return agreement.distilled_depth_loss(c.heads["depth"], c.taught["depth"], scale)


def _depth_consistency(c: Compared) -> Tensor:
    return agreement.depth_consistency_loss(*c.views("depth"))


def _depth_seam(c: Compared) -> Tensor:
    return agreement.depth_seam_loss(*c.views("depth"))


class Term(NamedTuple):
    """A term of the loss.

    Attributes:
        heads: heads that the network must have.
        target: the target in `Sample.targets` with which it compares; "" if there is none.
        loss: computes the term, a mean (), before weighting.
        weight: weight if the recipe has none in `loss.weights`; a term of weight 0 is not computed.
    """

    heads: frozenset[str]
    target: str
    loss: Callable[[Compared], Tensor]
    weight: float = 1.0


# Arguments: answer of the network (N, 1, H, W), labels (N, H, W), weight of each frame's labels
# (N,). Returns the loss (), a mean over the labelled pixels of all processes, see
# `training.losses.semantic`.
HeadLoss = Callable[[Tensor, Tensor, Tensor], Tensor]


def head_term(head: str, loss: HeadLoss, weight: float = 1.0) -> Term:
    """Return the term of a head of your own, a name in `NetworkOutput.others` and of the target.

    It belongs in `TERMS` under the name of the head, or in the entry points of `GROUP`.
    """

    def compare(c: Compared) -> Tensor:
        return loss(c.heads[head], c.batch.targets[head], c.batch.weights[head])

    return Term(frozenset({head}), head, compare, weight)


# Heads, target, loss and weight of each term. Those of the paper are Eq. 4, 5, 6, 8 and 11, whose
# weight is 1; their sum is Eq. 12. With the soft form of Eq. 8 and 11, training at weight 1 often
# collapses to one class, and 0.03 is used instead (docs/results.md).
TERMS: dict[str, Term] = {
    name: Term(frozenset(heads.split()), target, loss, weight)
    for name, heads, target, loss, weight in (
        ("depth", "depth", "depth", _depth, 1.0),
        # Likelihood of the depth's errors under the predicted uncertainty.
        ("depth_uncertainty", "depth depth_uncertainty", "depth", _depth_uncertainty, 0.1),
        ("semantic", "semantic", "semantic", _semantic, 1.0),
        # Soft IoU of the classes beside Eq. 5; not the paper's.
        ("semantic_iou", "semantic", "semantic", _semantic_iou, 0.0),
        # Of each picture (Berman et al. 2018); ENet with it is the paper's ENet_LSloss.
        ("lovasz", "semantic", "semantic", _lovasz, 0.0),
        # The class "road" against road masks, of sets without other labels; not the paper's.
        ("road", "semantic", "road_mask", _road, 0.0),
        ("boundary", "boundary", "semantic", _boundary, 1.0),
        ("semantic_boundary", "semantic boundary", "semantic", _semantic_boundary, 1.0),
        ("semantic_depth", "semantic depth", "semantic", _semantic_depth, 1.0),
        # Agreement of two shifted views of each frame, see `training.losses.agreement`.
        ("depth_consistency", "depth", "", _depth_consistency, 0.0),
        ("depth_seam", "depth", "", _depth_seam, 0.0),
        ("semantic_consistency", "semantic", "", _semantic_consistency, 0.0),
        # Agreement with the answers of a teacher, see `training.losses.agreement`.
        ("distilled_semantic", "semantic", "", _distilled_semantic, 0.0),
        ("distilled_depth", "depth", "", _distilled_depth, 0.0),
        ("distilled_boundary", "boundary", "", _distilled_boundary, 0.0),
    )
}
# Terms that compare two views of each frame.
PAIR_TERMS = frozenset({"depth_consistency", "depth_seam", "semantic_consistency"})
# Weights that leave only the terms of depth.
DEPTH_ALONE = {name: 0.0 for name in TERMS if not name.startswith("depth")}
# Group of the entry points with which other packages add terms.
GROUP = "ssdnet.losses"


def find_term(name: str) -> Term | None:
    """Return a term of `TERMS` or of an installed package; None if there is none of the name.

    Raises ValueError in the cases of `find_entry`.
    """
    return find_entry(GROUP, name, Term, TERMS)


def list_terms() -> list[str]:
    """Return the names of all terms, for messages."""
    return list_entries(GROUP, TERMS)
