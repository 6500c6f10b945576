"""Classes without a known name, whose meaning labelled pictures show."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import MIN_SIDE, NO_CLASS
from training.datasets.sample import Sample
from training.scores.scoring import torch_predict
from training.weights.initial_weights import Weights

# Least share of the labelled pixels answered as a class that must be of the class that is like it,
# and least share of the pixels of this class that must be answered so.
_PRECISION, _RECALL = 0.5, 0.25


def find_alike(
    samples: Iterable[Sample], init: Weights, relatives: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """Return the classes of `init` that the pixels of classes without relatives are answered as.

    Args:
        samples: frames with labels.
        init: the initial weights.
        relatives: for each class, in order of the ids, the classes of `init` that mean it, which
            are no others' then.
    """
    known = [info.name for info in init.network.config.classes]
    taken = {name for names in relatives.values() for name in names}
    free = [index for index, name in enumerate(known) if name not in taken]
    new = {name: index for index, name in enumerate(relatives) if not relatives[name]}
    if not (free and new):
        return {}
    counts = _count(samples, init)[: len(relatives)]
    precision = counts / np.maximum(1, counts.sum(axis=0))
    found = {}
    for name, index in new.items():
        alike = [other for other in free if precision[index, other] > _PRECISION]
        if counts[index, alike].sum() > _RECALL * counts[index].sum():
            found[name] = tuple(known[other] for other in alike)
    return found


def _count(samples: Iterable[Sample], init: Weights) -> NDArray[np.int64]:
    """Return the pixels of each label (256) with each answer of the network."""
    classes, predict = init.network.config.num_classes, torch_predict(init.network)
    counts = np.zeros((NO_CLASS + 1, classes), np.int64)
    for sample in samples:
        if min(sample.size) < MIN_SIDE:
            continue
        returns = np.zeros(sample.size, np.float32) if sample.returns is None else sample.returns
        answer = predict(sample.rgb, returns, sample.focal_length_px).semantic
        assert answer is not None
        pairs = sample.semantic.astype(np.int64) * classes + answer
        counts += np.bincount(pairs.ravel(), minlength=counts.size).reshape(counts.shape)
    return counts
