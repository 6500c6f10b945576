"""The Lovász-Softmax loss against its definition, set by set."""

import pytest
import torch

from training.losses.semantic import lovasz_softmax_loss, picture_mean


def picture(classes=4, size=(5, 7), seed=0):
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(classes, *size, generator=generator, dtype=torch.float64)
    semantic = torch.randint(0, classes - 1, size, generator=generator)  # the last is not shown
    semantic[0, :3] = 255
    return logits, semantic


def jaccard_loss(wrong, of_class):
    """1 - IoU of a class, given the set of pixels that are wrong about it and its own pixels."""
    return len(wrong) / len(wrong | of_class)


def reference(probabilities, semantic):
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
def test_it_is_the_definition(seed):
    logits, semantic = picture(seed=seed)
    probabilities = logits.softmax(dim=0)
    loss = lovasz_softmax_loss(probabilities, semantic)
    assert float(loss) == pytest.approx(reference(probabilities, semantic), abs=1e-12)


def test_pictures_without_labels_do_not_count():
    known = torch.tensor([True, False, True])[:, None, None].expand(3, 2, 2)
    losses = torch.tensor([0.5, 0.0, 0.25])
    weighted = picture_mean(losses, known, torch.tensor([1.0, 1.0, 0.2]))
    assert float(weighted) == pytest.approx((0.5 + 0.05) / 2)
