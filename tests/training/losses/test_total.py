"""Eq. 12: which terms there are, how they add up, and what masked targets do."""

import math
from dataclasses import replace

import pytest
import torch

from layouts.batch import batch_of
from models import NetworkOutput
from runtime.base.errors import InputError
from training.loading.batch import Pair
from training.losses import LossConfig, SSDNetLoss, class_weights
from training.losses.boundary import (
    balanced_cross_entropy,
    boundary_target,
    semantic_boundary_loss,
    semantic_depth_loss,
    soft_disagreement,
)
from training.losses.depth import depth_at_scale, laplace_loss, normalise_depth, paper_depth_loss
from training.losses.semantic import (
    class_shares,
    lovasz_softmax_loss,
    road_loss,
    soft_iou_loss,
    weighted_cross_entropy,
)
from training.losses.terms import TERMS, head_term

PLAIN = {"class_weights": None, "max_depth_m": 100.0, "unmeasured_range_m": 100.0, "road": None}


class Loss(SSDNetLoss):
    """Takes the targets of a batch one by one."""

    def __init__(self, config, **options):
        super().__init__(config, **PLAIN | options)

    def forward(self, output, semantic, depth, **others):
        return super().forward(output, batch_of(semantic, depth, **others))


ALL_OFF = dict.fromkeys(TERMS, 0.0)


@pytest.mark.parametrize(("loss", "text"), [
    (lambda logits, *_: logits.float().mean((1, 2, 3)), "returned torch.float32"),
    (lambda logits, *_: 1.0, "'semantic' returned <class 'float'>; expected a mean"),
    (lambda logits, *_: logits.nothing, "'semantic' failed with AttributeError: .*, line"),
])  # fmt: skip
def test_a_term_that_fails_is_named(monkeypatch, loss, text):
    monkeypatch.setitem(TERMS, "semantic", head_term("semantic", loss))
    found = leaves()
    output = NetworkOutput(found["semantic"], None, None)
    with pytest.raises(InputError, match=text):
        Loss(LossConfig(ALL_OFF | {"semantic": 1.0}))(
            output, torch.zeros(2, 16, 24, dtype=torch.uint8), torch.zeros(2, 16, 24)
        )


def leaves(count=2, size=(16, 24), classes=5, seed=0, dtype=torch.float32):
    """Return leaf tensors in place of what a network computes, so that they get gradients."""
    generator = torch.Generator().manual_seed(seed)

    def leaf(*shape):
        return torch.randn(*shape, generator=generator).to(dtype).requires_grad_()

    height, width = size
    return {
        "semantic": leaf(count, classes, height, width),
        "depth": leaf(count, 1, height, width),
        "coarse_depth": leaf(count, 1, height // 8, width // 8),
        "boundary": leaf(count, 1, height, width),
    }


def answer(parts):
    return NetworkOutput(
        semantic_logits=parts["semantic"],
        depths=(torch.sigmoid(parts["depth"]), torch.sigmoid(parts["coarse_depth"])),
        boundary_logits=parts["boundary"],
    )


def targets(count=2, size=(16, 24), classes=5, seed=1):
    generator = torch.Generator().manual_seed(seed)
    # Labels in squares of 4, so that some pixels are boundary and some are not.
    semantic = torch.randint(0, classes, (count, size[0] // 4, size[1] // 4), generator=generator)
    semantic = semantic.repeat_interleave(4, dim=1).repeat_interleave(4, dim=2)
    depth = 100 * torch.rand(count, 1, *size, generator=generator)
    depth[torch.rand(count, 1, *size, generator=generator) < 0.5] = 0
    return semantic, depth


def test_what_labels_lack_is_not_learned_from_their_frame():
    parts = leaves()
    semantic, depth = targets()
    semantic[semantic == 3] = 255
    none = dict.fromkeys(("depth", "boundary", "semantic_boundary", "semantic_depth"), 0.0)
    criterion = Loss(LossConfig(weights={**none, "semantic_iou": 1.0}))
    terms = criterion(answer(parts), semantic, depth, lacking=((3,), ()))
    terms["total"].backward()
    pushed = parts["semantic"].grad.abs().sum(dim=(2, 3)) > 0
    assert terms["total"].isfinite()
    assert pushed.tolist() == [[True, True, True, False, True], [True] * 5]


def test_total_is_the_weighted_sum_of_the_families():
    parts = leaves()
    semantic, depth = targets()
    weights = class_weights(torch.tensor([50, 40, 30, 20, 10]))
    sample_weight = torch.tensor([1.0, 0.2])
    config = LossConfig(
        weights={
            "depth": 0.5,
            "semantic": 2.0,
            "boundary": 3.0,
            "semantic_boundary": 0.7,
            "semantic_depth": 0.3,
            "semantic_iou": 1.5,
            "lovasz": 1.7,
            "road": 1.9,
        }
    )
    road_mask = torch.ones(semantic.shape, dtype=torch.uint8)
    given = {"semantic_weight": sample_weight, "road_mask": road_mask}
    criterion = Loss(config, class_weights=weights, road=1)
    terms = criterion(answer(parts), semantic, depth, **given)
    log_p = torch.log_softmax(parts["semantic"], dim=1)
    shares = class_shares(semantic, 5, (16, 24))
    maps = soft_disagreement(log_p.exp())
    of_pictures = list(map(lovasz_softmax_loss, log_p.exp(), semantic))
    target, valid = boundary_target(semantic)
    normalised = normalise_depth(depth, 100.0, 100.0)
    of_depth = [
        paper_depth_loss(
            torch.sigmoid(parts[name]), *depth_at_scale(*normalised, tuple(parts[name].shape[-2:]))
        )
        for name in ("depth", "coarse_depth")
    ]
    expected = {
        "depth": sum(of_depth) / 2,
        "semantic": weighted_cross_entropy(log_p, shares, weights, sample_weight),
        "semantic_iou": soft_iou_loss(log_p.exp(), shares, sample_weight),
        "lovasz": (of_pictures[0] + 0.2 * of_pictures[1]) / 2,
        "road": road_loss(parts["semantic"], road_mask, 1),
        "boundary": balanced_cross_entropy(parts["boundary"], target, valid, sample_weight),
        "semantic_boundary": semantic_boundary_loss(maps, torch.sigmoid(parts["boundary"]), side=1),
        "semantic_depth": semantic_depth_loss(maps, torch.sigmoid(parts["depth"]), side=1),
    }
    assert set(terms) == {*expected, "total"}
    for name, value in expected.items():
        assert terms[name].item() == pytest.approx(value.item(), rel=1e-5), name
        assert value.item() > 1e-3
    total = sum(config.weight(name) * value for name, value in expected.items())
    assert terms["total"].item() == pytest.approx(total.item(), rel=1e-5)


def test_depth_ends_where_the_regression_does():
    """Depth beyond half of the range of 200 m is no target, and the sky is no measurement."""
    parts = leaves()
    config = LossConfig(weights={**ALL_OFF, "depth": 1.0, "depth_uncertainty": 1.0})
    criterion = Loss(config, max_depth_m=200.0)
    scale = torch.full_like(parts["depth"], 0.01)

    def terms(far):
        semantic, depth = targets()
        depth[0, 0, :4], depth[0, 0, 4:8] = far, 100.0
        output = answer(parts)._replace(depth_uncertainty=scale)
        return criterion(output, semantic, depth), depth

    (found, depth), (without, _) = terms(150.0), terms(0.0)
    for name in ("depth", "depth_uncertainty"):
        torch.testing.assert_close(found[name], without[name])
    measured = (depth > 0) & (depth < 100)
    expected = laplace_loss(
        scale, torch.sigmoid(parts["depth"]), depth / 200, measured, max_depth_m=200.0
    )
    torch.testing.assert_close(found["depth_uncertainty"], expected)


@pytest.mark.parametrize("depth_form", ["paper", "metric"])
def test_samples_without_targets_get_no_gradient(depth_form):
    semantic, depth = targets()
    semantic[0], depth[1] = 255, 0  # sample 0 lacks labels, sample 1 lacks depth
    parts = leaves()
    given = dict.fromkeys(("semantic_iou", "lovasz", "road"), 1.0)
    off = {"semantic_boundary": 0.0, "semantic_depth": 0.0}
    config = LossConfig(depth_form=depth_form, weights={**off, **given})
    criterion = Loss(config, road=1)
    mask = torch.full(semantic.shape, 255, dtype=torch.uint8)
    criterion(answer(parts), semantic, depth, road_mask=mask)["total"].backward()
    for name, part in parts.items():
        assert part.grad.isfinite().all()
        empty = 1 if "depth" in name else 0
        assert part.grad[empty].abs().max() == 0, name
        assert part.grad[1 - empty].abs().max() > 0, name
    terms = criterion(answer(leaves()), 0 * semantic + 255, 0 * depth, road_mask=mask)
    assert {name: term.item() for name, term in terms.items()} == dict.fromkeys(terms, 0)


@pytest.mark.parametrize(("missing", "names"), [
    ("semantic_logits", {"depth", "boundary", "total"}),
    ("depths", {"semantic", "boundary", "semantic_boundary", "total"}),
])  # fmt: skip
def test_terms_of_absent_heads_are_left_out(missing, names):
    output = answer(leaves())._replace(**{missing: None})
    assert set(Loss(LossConfig())(output, *targets())) == names


def test_finest_scale_alone_leaves_the_coarse_ones_untrained():
    parts = leaves()
    config = LossConfig(depth_form="metric", depth_scales="finest")
    Loss(config)(answer(parts), *targets())["total"].backward()
    assert parts["coarse_depth"].grad is None
    assert parts["depth"].grad.abs().sum() > 0


def test_bf16_answers_are_scored_in_float32_under_autocast():
    parts = leaves(dtype=torch.bfloat16)
    criterion = Loss(LossConfig())
    with torch.autocast("cpu", dtype=torch.bfloat16):
        output = answer(parts)
        terms = criterion(output, *targets())
    depths = tuple(depth.float() for depth in output.depths)
    exact = NetworkOutput(output.semantic_logits.float(), depths, output.boundary_logits.float())
    torch.testing.assert_close(terms, criterion(exact, *targets()))
    terms["total"].backward()
    assert all(part.grad.isfinite().all() for part in parts.values())


def test_keys_of_earlier_releases_are_read_as_weights(monkeypatch):
    monkeypatch.setitem(TERMS, "other", head_term("other", lambda *_: torch.ones(())))
    old = LossConfig(depth_weight=0.5, head_weights={"other": 3.0}, weights={"lovasz": 2.0})
    assert old == LossConfig(weights={"depth": 0.5, "other": 3.0, "lovasz": 2.0})
    assert replace(old, road_weight=1.0).weights == {**old.weights, "road": 1.0}


@pytest.mark.parametrize("name", TERMS)
def test_each_term_is_computed_by_its_weight_alone(name):
    """The network has every head, and the batch has every target and two views."""
    semantic, depth = targets(size=(80, 88))
    lidar = torch.zeros(1, 1, 80, 88)
    batch = batch_of(
        semantic,
        depth,
        road_mask=torch.ones(semantic.shape, dtype=torch.uint8),
        pair=Pair(torch.zeros(1, 2, dtype=torch.int64), lidar, lidar),
        teacher=answer(leaves(size=(80, 88))),
    )
    output = answer(leaves(size=(80, 88)))
    output = output._replace(depth_uncertainty=torch.ones_like(output.depths[0]))
    config = LossConfig(weights={term: 2.0 * (term == name) for term in TERMS})
    terms = SSDNetLoss(config, **PLAIN | {"road": 1})(output, batch)
    assert set(terms) == {name, "total"}
    torch.testing.assert_close(terms["total"], 2 * terms[name])


def test_weights_of_unknown_terms_are_refused(monkeypatch):
    monkeypatch.setitem(TERMS, "other", head_term("other", lambda *_: torch.ones(())))
    with pytest.raises(ValueError, match=r"nonsense: unknown term; known: depth, .*, other"):
        LossConfig(weights={"nonsense": 3.0, "other": 1.0})


def test_learned_weighting_by_hand():
    parts = leaves()
    semantic, depth = targets()
    fixed = LossConfig(weights={"semantic": 2.0, "depth": 0.5})
    plain = Loss(fixed)(answer(parts), semantic, depth)
    criterion = Loss(replace(fixed, weighting="uncertainty"))
    names = [name for name in plain if name != "total"]
    assert set(criterion.log_variances) == set(names)  # a likelihood needs no weight learned
    values = {name: 0.3 * index - 0.5 for index, name in enumerate(names)}
    for name, value in values.items():
        criterion.log_variances[name].data.fill_(value)
    terms = criterion(answer(parts), semantic, depth)
    expected = 0.0
    for name, value in values.items():
        share = 0.5 if name == "depth" else 1.0
        weighted = fixed.weight(name) * plain[name].item()
        expected += share * weighted / math.exp(value) + value / 2
    assert terms["total"].item() == pytest.approx(expected, rel=1e-5)


def test_learned_weighting_counts_other_heads(monkeypatch):
    heads = {"other": 2.0, "unweighted": 0.0}
    for head in heads:
        monkeypatch.setitem(TERMS, head, head_term(head, lambda *_: torch.tensor(5.0)))
    config = LossConfig(weights={**ALL_OFF, **heads}, weighting="uncertainty")
    criterion = SSDNetLoss(config, **PLAIN)
    assert set(criterion.log_variances) == {"other"}
    criterion.log_variances["other"].data.fill_(0.5)
    maps = dict.fromkeys(heads, torch.zeros(2, 1, 16, 24))
    batch = replace(batch_of(*targets()), targets=maps, weights=maps)
    terms = criterion(NetworkOutput(others=maps), batch)
    assert set(terms) == {"other", "total"}
    assert terms["total"].item() == pytest.approx(2 * 5 / math.exp(0.5) + 0.25)


def test_semantic_logits_may_stay_on_their_own_grid():
    """As if they were repeated over the pixels of a cell; only the joint terms see cells."""
    parts = leaves(size=(16, 24))
    coarse = leaves(size=(8, 12))["semantic"]
    semantic, depth = targets()
    semantic[0, :3, 5:] = 255
    config = LossConfig(weights={"semantic_iou": 1.0, "lovasz": 1.0})
    criterion = Loss(config)
    repeated = coarse.detach().repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
    output = answer(parts)
    on_grid = criterion(output._replace(semantic_logits=coarse), semantic, depth)
    at_size = criterion(output._replace(semantic_logits=repeated), semantic, depth)
    for name in set(on_grid) - {"semantic_boundary", "semantic_depth", "total"}:
        assert on_grid[name].item() == pytest.approx(at_size[name].item(), rel=1e-5), name
    on_grid["total"].backward()
    assert all(parts[name].grad.any() for name in parts if name != "semantic")
    assert coarse.grad.any()

    # Repeated cells differ where cells meet, along two pixels each: the same sum over the pixels.
    maps = soft_disagreement(torch.softmax(coarse, dim=1))
    pooled = [
        torch.nn.functional.avg_pool2d(map_, 2)
        for map_ in (torch.sigmoid(output.boundary_logits), output.depths[0])
    ]
    expected = semantic_boundary_loss(maps, pooled[0], side=2)
    assert on_grid["semantic_boundary"].item() == pytest.approx(expected.item(), rel=1e-5)
    expected = semantic_depth_loss(maps, pooled[1], side=2)
    assert on_grid["semantic_depth"].item() == pytest.approx(expected.item(), rel=1e-5)
