"""A batch of given targets."""

import torch

from training.loading.batch import Batch


def batch_of(
    semantic, depth, *, semantic_weight=None, road_mask=None, pair=None, teacher=None, lacking=()
):
    """Semantic (N, H, W), depth (N, 1, H, W); a black image without LiDAR."""
    count, height, width = semantic.shape
    targets = {"semantic": semantic.to(torch.uint8), "depth": depth[:, 0]}
    if road_mask is not None:
        targets["road_mask"] = road_mask
    ones = torch.ones(count)
    weights = {**dict.fromkeys(targets, ones)}
    weights["semantic"] = ones if semantic_weight is None else semantic_weight
    rgb = torch.zeros(count, 3, height, width, dtype=torch.uint8)
    none = torch.zeros(count, 1, height, width)
    return Batch(rgb, none, targets, weights, [""] * count, pair, teacher, lacking)
