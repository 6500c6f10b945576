"""Scores of a network on whole frames, the same for PyTorch and for an exported file."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from models import SSDNet
from training.augment import keep_every_line, masked
from training.datasets.kitti_stream_lines import withhold_occluded
from training.datasets.sample import Sample, SampleSource, nothing_known
from training.lidar import scan_lines
from training.recipe import SourceRecipe


class Answer(NamedTuple):
    """What a predictor says about one frame; a head that it lacks is None."""

    semantic: NDArray[np.uint8] | None
    depth: NDArray[np.float32] | None
    boundary: NDArray[np.float32] | None


#: (rgb uint8 (H, W, 3), sparse_depth float32 (H, W) in metres) -> answer at the same size.
Predict = Callable[[NDArray[np.uint8], NDArray[np.float32]], Answer]


def torch_predict(network: SSDNet) -> Predict:
    """Return the PyTorch network as a predictor; it is put into evaluation mode."""
    network.eval()

    @torch.inference_mode()
    def predict(rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32]) -> Answer:
        device = network.rgb_mean.device
        output = network(
            torch.from_numpy(rgb).to(device).permute(2, 0, 1)[None].float(),
            torch.from_numpy(sparse_depth).to(device)[None, None],
        )
        semantic = depth = None
        if output.semantic_logits is not None:
            semantic = output.semantic_logits[0].argmax(0).to(torch.uint8).cpu().numpy()
        if output.depths is not None:
            depth = (output.depths[0][0, 0].float() * network.config.max_depth_m).cpu().numpy()
        return Answer(semantic, depth, torch.sigmoid(output.boundary_logits)[0, 0].cpu().numpy())

    return predict


def split_lidar(sample: Sample) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the input and the target of a frame for scoring depth, both float32 (H, W), metres.

    A recorded scan: every second line is fed, the others (less those hidden behind nearer
    returns) are scored. Dense depth: 64 simulated lines are fed, all of it is scored. No depth:
    neither.
    """
    if not sample.depth.any():
        return nothing_known(sample.size), sample.depth
    if sample.scan_line is not None:
        seen = keep_every_line(sample, 2, 0)
        return seen, withhold_occluded(masked(sample.depth, seen == 0), sample.depth)
    if sample.intrinsics is None:
        raise ValueError(f"{sample.name} has dense depth but no intrinsics to draw scan lines with")
    return scan_lines(sample.depth, sample.intrinsics, 64, np.random.default_rng(0)), sample.depth


def score_sources(
    network: SSDNet, sources: Mapping[str, tuple[SourceRecipe, SampleSource]]
) -> dict[str, float]:
    """Score a network on validation sets: mIoU where there are labels, MAE and RMSE where depth."""
    predict = torch_predict(network)
    scores = {}
    for name, (_, source) in sources.items():
        classes = network.config.num_classes
        confusion = np.zeros((classes, classes), dtype=np.int64)
        errors = []
        for index in range(len(source)):
            sample = source[index]
            seen, target = split_lidar(sample)
            answer = predict(sample.rgb, seen)
            known = sample.semantic < classes
            if answer.semantic is not None and known.any():
                pairs = sample.semantic[known].astype(np.int64) * classes + answer.semantic[known]
                confusion += np.bincount(pairs, minlength=classes**2).reshape(classes, classes)
            if answer.depth is not None:
                errors.append(answer.depth[target > 0] - target[target > 0])
        if confusion.any():
            hit = np.diag(confusion)
            union = confusion.sum(0) + confusion.sum(1) - hit
            scores[f"{name}/miou"] = float(np.mean(hit[union > 0] / union[union > 0]))
        difference = np.concatenate(errors) if errors else np.zeros(0)
        if difference.size:
            scores[f"{name}/mae_m"] = float(np.abs(difference).mean())
            scores[f"{name}/rmse_m"] = float(np.sqrt(np.square(difference).mean()))
    return scores
