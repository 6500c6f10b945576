"""Pictures of training inputs, and of a network's answers beside the ground truth."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from models import Network
from runtime.drawing.color_scale import NO_VALUE_COLOR, write_text
from runtime.drawing.overlay import Overlay
from training.datasets.sample import AUXILIARY, SampleSource, labelled
from training.lidar.split import LidarInput
from training.loading.batch import Batch
from training.loading.open_dataset import spread_indices
from training.scores.scoring import HeadMaps, Predict, split_frames

# Largest width of a panel in the pictures of a validation [px]; a long run has hundreds of them.
_WIDEST = 320
# Side of the dot of a return [px].
_DOT_PX = 3


def draw_pictures(
    predict: Predict, source: SampleSource, network: Network, *, lidar: LidarInput, count: int
) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Draw frames spread evenly over a set, like `runtime.drawing.overlay` draws them.

    Args:
        predict: the network's predictor.
        source: the set.
        network: the network, whose heads, classes and range the pictures have.
        lidar: the input that is fed.
        count: number of frames.

    Yields:
        Name of the frame and picture, uint8 (H', W', 3), RGB. On the left is the prediction, on the
        right are the labels and the depth where they are known; unknown classes are black.

    Raises:
        InputError: if the set cannot give the LiDAR.
    """
    overlay = Overlay(network.config.classes, network.config.max_depth_m)
    for frame in split_frames(source, spread_indices(source, count), lidar):
        sample = frame.sample
        truth = HeadMaps(**_labelled({**sample.targets, "depth": frame.target}, network.heads))
        drawn = [
            overlay.draw(sample.rgb, answer, widest=_WIDEST)
            for answer in (predict(sample.rgb, frame.fed, sample.focal_length_px), truth)
        ]
        height = max(picture.shape[0] for picture in drawn)
        padded = [
            cv2.copyMakeBorder(picture, 0, height - picture.shape[0], 0, 0, cv2.BORDER_CONSTANT)
            for picture in drawn
        ]
        yield sample.name, np.ascontiguousarray(cv2.hconcat(padded)[..., ::-1], np.uint8)


def _labelled(
    targets: Mapping[str, NDArray[Any]], heads: Collection[str]
) -> dict[str, NDArray[Any]]:
    """Return the targets of these heads that have a label; NaN is drawn like 0."""
    return {
        name: np.nan_to_num(values)
        for name, values in targets.items()
        if name in heads and labelled(name, values).any()
    }


def draw_batch(batch: Batch, overlay: Overlay, *, count: int) -> NDArray[np.uint8]:
    """Draw a batch of a `Mixture`, with a row for each sample and its name.

    Args:
        batch: frames with one or two views each.
        overlay: overlay with the classes and the range of the depth.
        count: largest number of frames.

    Returns:
        uint8 (H, W, 3), BGR: image, labels and depth target as `Overlay` draws them, if the batch
        has any, and the LiDAR input as dots over the faded image.
    """
    names, width = batch.names[:count], batch.rgb.shape[-1]
    # The views of a frame are drawn one above the other.
    shown = [i for row in range(len(names)) for i in range(row, len(batch.rgb), len(batch.names))]

    def column(values: Tensor) -> NDArray[Any]:
        return values[shown].reshape(-1, width).numpy()

    rgb = batch.rgb[shown].movedim(-3, -1).reshape(-1, width, 3).numpy()
    fed = column(batch.sparse_depth)
    columns = {name: column(labels) for name, labels in batch.targets.items()}
    targets = HeadMaps(**_labelled(columns, columns.keys() - AUXILIARY.keys()))
    (input_panel,) = overlay.panels(rgb // 3 + 85, HeadMaps()).values()
    (colors,) = overlay.panels(None, HeadMaps(depth=enlarge_returns(fed, _DOT_PX))).values()
    np.copyto(input_panel, colors, where=(colors != NO_VALUE_COLOR).any(axis=-1, keepdims=True))
    panels = {**overlay.panels(rgb, targets), "LiDAR input": input_panel}
    for title, panel in panels.items():
        write_text(panel, title, (6, 16))
    strip = cv2.hconcat(list(panels.values()))
    picture = cv2.vconcat([strip, overlay.draw_legend(strip.shape[1], targets.heads)])
    for index, name in enumerate(names, start=1):
        write_text(picture, name, (6, input_panel.shape[0] * index // len(names) - 6))
    return picture  # type: ignore[return-value]


def enlarge_returns(depth: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Enlarge the returns of a depth map to dots of `side` pixels, the nearest in front."""
    nearness = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    nearness = np.asarray(cv2.dilate(nearness, np.ones((side, side), np.uint8)))
    return np.divide(1, nearness, out=np.zeros_like(depth), where=nearness > 0)
