"""Losses of classes against PyTorch, plain formulas and sets, class weights by hand."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from training.losses.semantic import (
    class_shares,
    class_weights,
    lovasz_softmax_loss,
    road_loss,
    soft_iou_loss,
    weighted_cross_entropy,
)


def test_class_weights_by_hand():
    counts = torch.tensor([800, 100, 50, 40, 10])  # frequencies .8 .1 .05 .04 .01, median .05
    expected = [0.0625, 0.5, 1.0, 1.25, 5.0]
    assert class_weights(counts, "median").tolist() == pytest.approx(expected)
    roots = [math.sqrt(value) for value in expected]
    assert class_weights(counts, "sqrt_median").tolist() == pytest.approx(roots)
    assert class_weights(counts, "paper").tolist() == pytest.approx([0.8, 0.1, 0.05, 0.04, 0.01])
    assert class_weights(counts, "none").tolist() == [1.0] * 5
    assert class_weights(0 * counts, "median").tolist() == [1.0] * 5


def test_class_weights_of_unseen_and_even_counts():
    weights = class_weights(torch.tensor([30, 0, 10]), "median")  # median of .75 and .25 is .5
    assert weights.tolist() == pytest.approx([2 / 3, 2.0, 2.0])
    assert class_weights(torch.tensor([30, 0, 10]), "paper").tolist() == pytest.approx(
        [0.75, 0, 0.25]
    )


def shares_of(semantic, like):
    """Shares on the grid of `like`, (N, C, h, w)."""
    return class_shares(torch.as_tensor(semantic), like.shape[1], tuple(like.shape[-2:])).to(like)


@pytest.mark.parametrize("weighting", ["median", "sqrt_median", "paper", "none"])
def test_weighted_cross_entropy_is_pytorchs_with_frames_weighed(weighting):
    logits = torch.randn(2, 4, 5, 6, generator=torch.Generator().manual_seed(0))
    semantic = np.random.default_rng(0).choice([0, 0, 0, 1, 2, 2, 3, 255], size=(2, 5, 6))
    semantic, sample_weight = torch.from_numpy(semantic), torch.tensor([1.0, 0.2])
    weights = class_weights(torch.bincount(semantic.flatten())[:4], weighting)
    log_p, shares = logits.log_softmax(dim=1), shares_of(semantic, logits)
    ours = weighted_cross_entropy(log_p, shares, weights, sample_weight)
    of_pixels = F.cross_entropy(logits, semantic, weights, ignore_index=255, reduction="none")
    expected = (of_pixels * sample_weight[:, None, None]).sum() / (semantic != 255).sum()
    assert ours.item() == pytest.approx(expected.item(), rel=1e-5)


def soft_iou_by_classes(probabilities, semantic, sample_weight):
    weight = (semantic != 255) * np.reshape(sample_weight, (-1, 1, 1))
    losses = []
    for k in range(probabilities.shape[1]):
        of_class, p = weight * (semantic == k), probabilities[:, k]
        if of_class.any():
            both = (of_class * p).sum()
            losses.append(1 - both / ((weight * p).sum() + of_class.sum() - both))
    return sum(losses) / len(losses)


@pytest.mark.parametrize("sample_weight", [(1.0, 1.0), (1.0, 0.2), (0.0, 1.0)])
def test_soft_iou_is_the_mean_over_the_classes_that_are_shown(sample_weight):
    rng = np.random.default_rng(0)
    logits = torch.from_numpy(rng.standard_normal((2, 5, 6, 7)))
    probabilities = torch.softmax(logits, dim=1)
    semantic = rng.choice([0, 0, 1, 2, 2, 255], size=(2, 6, 7))  # 3 and 4 are never seen
    semantic[1][semantic[1] == 1] = 0
    shares = shares_of(semantic, probabilities)
    loss = soft_iou_loss(probabilities, shares, torch.tensor(sample_weight).double())
    expected = soft_iou_by_classes(probabilities.numpy(), semantic, sample_weight)
    assert loss.item() == pytest.approx(expected, rel=1e-9)


def picture(classes=4, size=(5, 7), seed=0):
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(classes, *size, generator=generator, dtype=torch.float64)
    semantic = torch.randint(0, classes - 1, size, generator=generator)  # the last is not shown
    semantic[0, :3] = 255
    return logits, semantic


def jaccard_loss(wrong, of_class):
    """1 - IoU of a class, given the set of pixels that are wrong about it and its own pixels."""
    return len(wrong) / len(wrong | of_class)


def lovasz_by_sets(probabilities, semantic):
    pixels = [(int(y), int(x)) for y, x in (semantic != 255).nonzero()]
    losses = []
    for index in range(len(probabilities)):
        of_class = {p for p in pixels if semantic[p] == index}
        if not of_class:
            continue
        errors = {p: abs(float(p in of_class) - float(probabilities[index][p])) for p in pixels}
        loss, wrong, before = 0.0, set(), 0.0
        for p in sorted(pixels, key=lambda p: -errors[p]):
            wrong = wrong | {p}
            now = jaccard_loss(wrong, of_class)
            loss, before = loss + errors[p] * (now - before), now
        losses.append(loss)
    return sum(losses) / len(losses)


@pytest.mark.parametrize("seed", range(3))
def test_lovasz_softmax_is_its_definition(seed):
    logits, semantic = picture(seed=seed)
    probabilities = logits.softmax(dim=0)
    loss = lovasz_softmax_loss(probabilities, semantic)
    assert float(loss) == pytest.approx(lovasz_by_sets(probabilities, semantic), abs=1e-12)


def road_logits(*, requires_grad=False):
    """Three classes on 4 x 6 pixels, the road the second."""
    values = torch.randn(2, 3, 4, 6, generator=torch.Generator().manual_seed(0))
    return values.requires_grad_(requires_grad)


def test_a_road_mask_is_the_binary_cross_entropy_of_the_class():
    mask = torch.full((2, 4, 6), 255, dtype=torch.uint8)
    mask[0, 1, 2], mask[0, 3, 5], mask[1, 0, 0] = 1, 0, 0
    p = road_logits().softmax(dim=1)[:, 1]
    expected = -(p[0, 1, 2].log() + (1 - p[0, 3, 5]).log() + (1 - p[1, 0, 0]).log()) / 3
    torch.testing.assert_close(road_loss(road_logits(), mask, 1), expected)


def test_a_road_mask_does_not_say_which_other_class_it_is():
    """Odds among the others stay: their gradients stand in the ratio of their probabilities."""
    values = road_logits(requires_grad=True)
    road_loss(values, torch.zeros(2, 4, 6, dtype=torch.uint8), 1).backward()
    p = values.detach().softmax(dim=1)
    assert (values.grad[:, 1] > 0).all()
    torch.testing.assert_close(values.grad[:, 0] * p[:, 2], values.grad[:, 2] * p[:, 0])


def test_sure_answers_about_the_road_have_a_finite_loss():
    sure = torch.tensor([500.0, -500.0, 0.0]).view(1, 3, 1, 1)
    mask = torch.ones(1, 1, 1, dtype=torch.uint8)
    assert road_loss(sure, mask, 1).item() == pytest.approx(1000.0)
    assert road_loss(sure, mask, 0).item() == 0


def test_a_coarser_grid_of_the_road_counts_every_pixel_in_its_cell():
    """Logits of cells score as if they were repeated over their pixels, also at the border."""
    coarse = torch.randn(1, 3, 2, 3, generator=torch.Generator().manual_seed(1))
    mask = torch.randint(0, 3, (1, 7, 9), generator=torch.Generator().manual_seed(2))
    mask = torch.where(mask == 2, 255, mask).to(torch.uint8)
    repeated = coarse.repeat_interleave(4, dim=2).repeat_interleave(4, dim=3)[..., :7, :9]
    torch.testing.assert_close(road_loss(coarse, mask, 1), road_loss(repeated, mask, 1))
