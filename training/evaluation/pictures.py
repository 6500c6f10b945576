"""Pictures of a network's answers to frames of a data set beside the ground truth."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from models import Network
from runtime.drawing.overlay import Overlay
from training.datasets.sample import IGNORE, SampleSource
from training.evaluation.scoring import Answer, Predict, split_frames
from training.lidar.split import LidarInput


def draw_pictures(
    predict: Predict,
    source: SampleSource,
    network: Network,
    *,
    lidar: LidarInput,
    count: int,
) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Draw frames spread evenly over a set, as `runtime.drawing.overlay` draws them.

    Args:
        predict: the network's predictor.
        source: the set.
        network: whose heads, classes and range the pictures have.
        lidar: what is fed.
        count: number of frames.

    Yields:
        Name of the frame and picture, uint8 (H', W', 3), RGB: left the prediction, right the labels
        and the depth where they are known; unknown classes are black.

    Raises:
        InputError: for a LiDAR that the set cannot give.
    """
    overlay = Overlay(network.config.classes, network.config.max_depth_m)
    indices = np.unique(np.linspace(0, len(source) - 1, count).round().astype(int))
    for frame in split_frames(source, indices.tolist(), lidar):
        sample = frame.sample
        labelled = "semantic" in network.heads and (sample.semantic != IGNORE).any()
        truth = Answer(
            sample.semantic if labelled else None,
            frame.target if "depth" in network.heads and frame.target.any() else None,
            None,
        )
        drawn = [
            overlay.draw(sample.rgb, answer)
            for answer in (predict(sample.rgb, frame.fed, sample.focal_length_px), truth)
        ]
        height = max(picture.shape[0] for picture in drawn)
        padded = [
            cv2.copyMakeBorder(picture, 0, height - picture.shape[0], 0, 0, cv2.BORDER_CONSTANT)
            for picture in drawn
        ]
        yield sample.name, np.ascontiguousarray(cv2.hconcat(padded)[..., ::-1])
