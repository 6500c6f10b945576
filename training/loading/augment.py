"""Joint augmentation: one random change of RGB, depth, labels and intrinsics together."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import InputError
from runtime.contract.contract import MAX_RETURN_M, MIN_SIDE, farthest_return
from runtime.contract.resize import (
    RESIZE,
    move_returns,
    move_scan_lines,
    resize_image,
    resize_nearest,
)
from training.datasets.sample import IGNORE, Sample, nothing_known, target_kind
from training.lidar.faults import absorb, add_false_returns, drop_sectors, misalign
from training.lidar.split import SENSOR_LINES, LidarInput, masked, split_lidar
from training.limits import (
    PAIR_BORDER_PX,
    STRICT,
    CropSide,
    Degrees,
    FactorRange,
    PairShift,
    Share,
    ShareRange,
    Strength,
)

Depth = NDArray[np.float32]

# A depth map with more than this share of known pixels is dense, and a LiDAR is simulated from it.
# Accumulated scans know 20 % of the pixels, rendered streets at least 33 %.
_DENSE_SHARE = 0.3
# Sky pixels this close to another class have no depth target. The second margin is for labels that
# a network made.
SKY_MARGIN_PX, PSEUDO_SKY_MARGIN_PX = 2, 10
# Like `AugmentConfig.random_share`, but for recorded returns instead of pixels.
_RECORDED_SHARE = (0.05, 0.8)
# Largest rotation [degrees] about each axis and shift [m] along it of a misaligned LiDAR.
MISALIGNMENT_DEG, MISALIGNMENT_M = 0.5, 0.05
# Range of the share of the image's width that a missing sector has.
SECTOR_SHARE = (0.05, 0.3)
# Default crop. Smaller data has a smaller crop, see `training.loading.augment`.
LARGEST_CROP = (320, 480)
# RGB of padding: the mean colour by which networks normalise.
_FILL_RGB = (124, 116, 104)


# A crop's rows are a multiple of this: the stride of most networks.
_CROP_STEP = 32


@dataclass(frozen=True, config=STRICT)
class AugmentConfig:
    """Ranges and probabilities of the random changes.

    Attributes:
        crop: (height, width) of the result; None: from the height of the data, see `with_crop`.
        scale: range of the random magnification of the image.
        rare_crops: share of the crops that are chosen for rare classes: of `crop_candidates` random
            crops, the crop with the most pixels of `data.rare_classes`.
        brightness: largest relative change of brightness, contrast and saturation, and largest hue
            shift [degrees].
        lidar_missing: probability that the LiDAR is missing.
        lidar_random: probability that the input is a random share of the measurements instead of
            scan lines.
        random_share: range of the random share, log-uniform. For dense depth it is a share of the
            pixels; for recorded returns see `_RECORDED_SHARE`.
        lines: numbers of scan lines to choose from. A recorded scan keeps every 64/n-th line. 128
            lines need dense depth, otherwise 64 are used.
        lidar_misaligned: probability of an error of the LiDAR's extrinsics; ignored without
            intrinsics.
        lidar_dropout: probability that one to three sectors of the LiDAR are missing.
        lidar_absorbed: probability that one labelled object, such as a car, or its upper part has
            no returns.
        world_scale: range of a random factor of all depth in frames with LiDAR input, so that the
            network takes the scale from the returns instead of the image. (1, 1) changes nothing.
        pair_shift: largest shift [px] of a second view of each frame, for the consistency losses.
            Shifts are multiples of the stride of the semantic head. 0: there is one view.
        pair_lidar_missing: probabilities that the second view has no LiDAR, and that it has false
            returns.
    """

    crop: tuple[CropSide, CropSide] | None = None
    scale: FactorRange = (0.7, 1.8)
    rare_crops: Share = 0.0
    crop_candidates: Annotated[int, Field(ge=1, le=100)] = 4
    flip: Share = 0.5
    brightness: Strength = 0.3
    contrast: Strength = 0.3
    saturation: Strength = 0.3
    hue_deg: Degrees = 8.0
    gray: Share = 0.02
    blur: Share = 0.1
    noise: Share = 0.1
    lidar_missing: Share = 0.1
    lidar_random: Share = 0.3
    random_share: ShareRange = (0.01, 0.08)
    lines: Annotated[
        tuple[Literal[1, 2, 4, 8, 16, 32, 64, 128], ...], Field(min_length=1, max_length=100)
    ] = (64, 32, 16)
    lidar_misaligned: Share = 0.0
    lidar_dropout: Share = 0.0
    lidar_absorbed: Share = 0.0
    world_scale: FactorRange = (1.0, 1.0)
    pair_shift: PairShift = 0
    pair_lidar_missing: Share = 0.0
    pair_lidar_false: Share = 0.0

    def __post_init__(self) -> None:
        """Check that two views overlap."""
        if self.pair_shift and min(self.size) <= self.pair_shift + 2 * PAIR_BORDER_PX:
            raise ValueError(
                f"pair_shift = {self.pair_shift}: two views of {self.size[0]}x{self.size[1]} would "
                f"not overlap inside their borders of {PAIR_BORDER_PX} px"
            )

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the result."""
        return self.crop or LARGEST_CROP


def augment(
    sample: Sample,
    config: AugmentConfig,
    rng: Generator,
    *,
    canonical_focal_px: float | None = None,
    max_depth_m: float = MAX_RETURN_M,
    rare: Sequence[int] = (),
) -> Sample:
    """Return a randomly changed sample; a pure function of its arguments.

    Args:
        sample: a frame of a data set.
        config: ranges and probabilities.
        rng: source of all random numbers.
        canonical_focal_px: makes the depth canonical, see `canonical_depth`; None: metres.
        max_depth_m: the network's range, for canonical depth.
        rare: ids of the rare classes, see `config.rare_crops`.

    Returns:
        A sample of size `config.size` with a sparse depth.
    """
    # With canonical depth, images without intrinsics count as taken by the canonical camera. Its
    # focal length is fixed, so a magnified image is an image taken closer to the scene.
    is_closer = canonical_focal_px is not None and sample.intrinsics is None
    sample = scale_and_crop(sample, config, rng, is_closer=is_closer, rare=rare)
    if rng.random() < config.flip:
        sample = flip(sample)
    sample = draw_lidar(sample, config, rng)
    if canonical_focal_px is not None:
        sample = canonical_depth(sample, canonical_focal_px, max_depth_m)
    return replace(sample, rgb=change_colors(sample.rgb, config, rng))


def with_margin(config: AugmentConfig) -> AugmentConfig:
    """Return a configuration whose crop has room for both views, see `take_views`."""
    height, width = config.size
    crop = (height + config.pair_shift, width + config.pair_shift)
    return replace(config, crop=crop) if config.pair_shift else config


def take_views(
    sample: Sample, config: AugmentConfig, rng: Generator, *, step: int
) -> tuple[Sample, Sample, tuple[int, int]]:
    """Return two views of `config.size` and the offset (rows, columns) [px] of the second.

    The offset is a multiple of `step`. `sample` has the size of `with_margin`; the first view
    is its upper left corner. The LiDAR input of the second view is missing or has false returns,
    with the probabilities of `config`.
    """
    top, left = (step * int(count) for count in rng.integers(0, config.pair_shift // step + 1, 2))
    draw = rng.random()
    fed = sample.sparse_depth
    if draw < config.pair_lidar_missing:
        fed = nothing_known(sample.size)
    elif draw < config.pair_lidar_missing + config.pair_lidar_false:
        assert fed is not None
        fed = add_false_returns(fed, rng)
    second = cut(replace(sample, sparse_depth=fed), top, left, config.size)
    return cut(sample, 0, 0, config.size), second, (top, left)


def scale_world(
    views: Sequence[Sample], config: AugmentConfig, rng: Generator, *, max_depth_m: float
) -> tuple[Sample, ...]:
    """Multiply all depth of a frame's views by one random factor of `config.world_scale`.

    Without returns in each view nothing changes: then the scale is learned from the image. Returns
    beyond `max_depth_m`, in the unit of the samples, are clipped to it.
    """
    low, high = config.world_scale
    fed = (view.sparse_depth for view in views)
    if low == high == 1 or not all(depth is not None and depth.any() for depth in fed):
        return tuple(views)
    factor = float(np.exp(rng.uniform(*np.log((low, high)))))
    return tuple(_scale_depth(view, factor, max_depth_m) for view in views)


def scale_and_crop(
    sample: Sample,
    config: AugmentConfig,
    rng: Generator,
    *,
    is_closer: bool = False,
    rare: Sequence[int] = (),
) -> Sample:
    """Magnify by a random factor and cut a random window of `config.size`.

    Some windows are chosen for the classes `rare`, see `AugmentConfig.rare_crops`. Padding has
    the mean colour, no depth and no label. The factor scales the intrinsics; if `is_closer`, it
    divides the depth instead.
    """
    scale = float(np.exp(rng.uniform(*np.log(config.scale))))
    height, width = config.size
    window = (round(height / scale), round(width / scale))  # in pixels of the sample
    chosen = rare and config.rare_crops and rng.random() < config.rare_crops
    count = config.crop_candidates if chosen else 1
    offsets = [_random_offset(sample.size, window, rng) for _ in range(count)]
    top, left = choose_crop(sample.semantic, window, offsets, rare)
    is_dense = _is_dense(sample)  # before cropping: a crop of dense depth may be mostly sky
    sample = resize(cut(sample, top, left, window), config.size, is_dense=is_dense)
    return _scale_depth(sample, 1 / scale) if is_closer else sample


def canonical_depth(sample: Sample, focal_px: float, max_depth_m: float) -> Sample:
    """Multiply all depth by `focal_px` / fx, the depth for a camera of this focal length [px].

    Things of the same size in the image then have the same depth, whatever the camera (Yin et al.
    2023, Metric3D, Sec. 3.2, "CSTM label"). Returns beyond `max_depth_m`, the network's range in
    canonical metres, are clipped to it or dropped as by the engine, see `farthest_return`. The
    intrinsics do not change; without intrinsics nothing does.
    """
    focal = sample.focal_length_px
    if focal is None:
        return sample
    factor = focal_px / focal
    if (fed := sample.sparse_depth) is not None:  # `farthest_return` is in metres
        fed = masked(fed, fed <= farthest_return(max_depth_m / factor))
        sample = replace(sample, sparse_depth=fed)
    return _scale_depth(sample, factor, max_depth_m)


def _scale_depth(sample: Sample, factor: float, farthest: float = np.inf) -> Sample:
    """Multiply all depth by a factor; returns then beyond `farthest` are set to it."""
    if "depth" in sample.targets:
        sample = sample.with_targets(depth=sample.depth * np.float32(factor))
    if sample.sparse_depth is None:
        return sample
    fed = np.minimum(sample.sparse_depth * np.float32(factor), np.float32(farthest))
    return replace(sample, sparse_depth=fed)


def _change_maps(
    sample: Sample,
    change: Callable[[NDArray[Any], object], NDArray[Any]],
    intrinsics: NDArray[np.float64] | None,
) -> Sample:
    """Apply `change(map, fill)` to every map of a sample; fill: the value of unknown pixels."""

    def change_known(array: NDArray[Any] | None, unknown: object) -> NDArray[Any] | None:
        return None if array is None else change(array, unknown)

    return replace(
        sample,
        rgb=change(sample.rgb, _FILL_RGB),
        sparse_depth=change_known(sample.sparse_depth, 0),
        scan_line=change_known(sample.scan_line, -1),
        targets={
            name: change(labels, target_kind(name).unlabelled)
            for name, labels in sample.targets.items()
        },
        intrinsics=intrinsics,
    )


def far_sky(sample: Sample, sky: int, depth_m: float) -> Sample:
    """Set the depth target of the class `sky` to `depth_m`, in the unit of the sample's depth.

    Measured pixels do not change. Pixels within `SKY_MARGIN_PX` of another class do not change
    (`PSEUDO_SKY_MARGIN_PX` if a network made the labels), because leaves and wires in front of the
    sky are labelled as sky. A sample without any depth does not change: its only targets would be
    far. Call this after simulating the LiDAR.
    """
    if not sample.depth.any():
        return sample
    unmeasured = sample.depth == 0
    if sample.sparse_depth is not None:
        unmeasured &= sample.sparse_depth == 0
    margin = SKY_MARGIN_PX if sample.weights.get("semantic", 1) == 1 else PSEUDO_SKY_MARGIN_PX
    window = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    inner = cv2.erode((sample.semantic == sky).astype(np.uint8), window) > 0
    is_sky = unmeasured & inner
    return sample.with_targets(depth=np.where(is_sky, np.float32(depth_m), sample.depth))


def cut(sample: Sample, top: int, left: int, window: tuple[int, int]) -> Sample:
    """Cut (height, width) at (top, left); the window may reach beyond the image."""
    intrinsics = sample.intrinsics
    if intrinsics is not None:
        intrinsics = intrinsics - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]], np.float64)
    return _change_maps(
        sample, lambda array, fill: _take_window(array, top, left, window, fill), intrinsics
    )


def resize(sample: Sample, size: tuple[int, int], *, is_dense: bool | None = None) -> Sample:
    """Resize to (height, width) by the engine's rule, see `runtime.contract.resize`.

    Labels are resized by the rule of their head, dense depth by nearest neighbour. Recorded returns
    are moved one by one: none is duplicated, and of several on a pixel the nearest is kept.
    `is_dense`: whether the depth is dense; None: by its share of known pixels.
    """
    if size == sample.size:
        return sample
    fx, fy = size[1] / sample.size[1], size[0] / sample.size[0]

    intrinsics = sample.intrinsics
    if intrinsics is not None:
        # Pixel centres are integers in K: u' = (u + 0.5) f - 0.5.
        cx, cy = (intrinsics[0, 2] + 0.5) * fx - 0.5, (intrinsics[1, 2] + 0.5) * fy - 0.5
        intrinsics = np.array(
            [[intrinsics[0, 0] * fx, 0, cx], [0, intrinsics[1, 1] * fy, cy], [0, 0, 1]]
        )
    sparse_depth, scan_line = sample.sparse_depth, sample.scan_line
    if sparse_depth is not None:
        if is_dense is None:
            is_dense = _is_dense(sample)
        depth = (resize_nearest if is_dense else move_returns)(sample.depth, size)
        if scan_line is None:
            sparse_depth = move_returns(sparse_depth, size)
        else:
            sparse_depth, scan_line = move_scan_lines(sparse_depth, scan_line, size)
    elif scan_line is not None:
        depth, scan_line = move_scan_lines(sample.depth, scan_line, size)
    else:
        depth = resize_nearest(sample.depth, size)
    targets = {
        name: RESIZE[target_kind(name).resize](labels, size)
        for name, labels in sample.targets.items()
        if name != "depth"
    }
    if "depth" in sample.targets:
        targets["depth"] = depth
    return replace(
        sample,
        rgb=resize_image(sample.rgb, size),
        sparse_depth=sparse_depth,
        targets=targets,
        scan_line=scan_line,
        intrinsics=intrinsics,
    )


def flip(sample: Sample) -> Sample:
    """Mirror left and right; the principal point moves with the pixels."""
    intrinsics = sample.intrinsics
    if intrinsics is not None:
        intrinsics = intrinsics.copy()
        intrinsics[0, 2] = sample.size[1] - 1 - intrinsics[0, 2]
    return _change_maps(sample, lambda array, _: cv2.flip(array, 1), intrinsics)


def draw_lidar(sample: Sample, config: AugmentConfig, rng: Generator) -> Sample:
    """Choose the LiDAR input and the depth target, see `training.lidar.split`."""
    lidar = _choose_lidar(sample, config, rng)
    first_line = int(rng.integers(SENSOR_LINES))
    if lidar.lines > SENSOR_LINES:  # more than any recorded scan has: simulated
        sample = replace(sample, sparse_depth=None, scan_line=None)
    split = split_lidar(sample, lidar, rng, same_target=False, first_line=first_line)
    assert split is not None  # `_choose_lidar` takes what the sample has
    fed = _disturb(split.fed, sample, config, rng)
    return replace(sample, sparse_depth=fed).with_targets(depth=split.target)


def _disturb(
    fed: NDArray[np.float32], sample: Sample, config: AugmentConfig, rng: Generator
) -> NDArray[np.float32]:
    """Apply faults of the LiDAR (misalignment, dropout, absorption) with their probabilities."""
    intrinsics = sample.intrinsics
    is_misaligned = config.lidar_misaligned and rng.random() < config.lidar_misaligned
    if is_misaligned and intrinsics is not None and fed.any():
        fed = misalign(fed, intrinsics, rng, rotation_deg=MISALIGNMENT_DEG, shift_m=MISALIGNMENT_M)
    if config.lidar_dropout and rng.random() < config.lidar_dropout:
        fed = drop_sectors(fed, SECTOR_SHARE, rng)
    if config.lidar_absorbed and rng.random() < config.lidar_absorbed:
        fed = absorb(fed, sample.semantic, rng, ignore=IGNORE)
    return fed


def _is_dense(sample: Sample) -> bool:
    """Whether the depth is known for most surfaces, as rendered depth is, and not a scan."""
    is_scan = sample.scan_line is not None and sample.sparse_depth is None
    known = int(np.count_nonzero(sample.depth))
    return not is_scan and known > _DENSE_SHARE * sample.depth.size


def _choose_lidar(sample: Sample, config: AugmentConfig, rng: Generator) -> LidarInput:
    """Choose no input, a random share of the measurements, scan lines, or the recorded input."""
    missing = rng.random() < config.lidar_missing
    random = rng.random() < config.lidar_random
    lines = int(rng.choice(config.lines))
    if lines > SENSOR_LINES and (sample.intrinsics is None or not _is_dense(sample)):
        lines = SENSOR_LINES
    is_recorded = sample.sparse_depth is not None or sample.scan_line is not None
    if missing:
        return LidarInput("none")
    if random or not (is_recorded or sample.intrinsics is not None):
        low, high = _RECORDED_SHARE if is_recorded else config.random_share
        share = low * (high / low) ** rng.random()  # log-uniform: few returns as often as many
        return LidarInput("random", share=share)
    if is_recorded and sample.scan_line is None and lines <= SENSOR_LINES:
        return LidarInput("own")
    if sample.sparse_depth is None and sample.scan_line is not None:
        # All lines of the sensor would leave no target: at least every second is withheld.
        lines = min(lines, SENSOR_LINES // 2)
    return LidarInput("lines", lines=lines)


def change_colors(
    rgb: NDArray[np.uint8], config: AugmentConfig, rng: Generator
) -> NDArray[np.uint8]:
    """Change brightness, contrast, saturation and hue; blur and add noise by probability."""

    def change(most: float) -> float:
        return rng.uniform(-most, most)

    gain = 1 + change(config.contrast)
    offset = 255 * change(config.brightness) * 0.5
    saturation = 0.0 if rng.random() < config.gray else 1 + change(config.saturation)
    hue = np.deg2rad(change(config.hue_deg))
    # One affine map of the colours does all four (YIQ rotation for the hue).
    to_yiq = np.array([[0.299, 0.587, 0.114], [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
    cosine, sine = saturation * np.cos(hue), saturation * np.sin(hue)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    matrix = gain * (np.linalg.inv(to_yiq) @ turn @ to_yiq)
    shift = np.full((3, 1), offset + 127.5 * (1 - gain))
    out = cv2.transform(rgb.astype(np.float32), np.hstack([matrix, shift]))
    if rng.random() < config.blur:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.2))
    if rng.random() < config.noise:
        out = out + rng.normal(0, rng.uniform(2, 10), rgb.shape).astype(np.float32)
    return np.clip(out, 0, 255).astype(np.uint8)


def _random_offset(
    size: tuple[int, int], window: tuple[int, int], rng: Generator
) -> tuple[int, int]:
    """Return a random (row, column) of a window's upper left corner.

    Along an axis where the window is larger than the image, it covers the whole image.
    """

    def start(room: int) -> int:
        return int(rng.integers(min(0, room), max(0, room) + 1))

    return start(size[0] - window[0]), start(size[1] - window[1])


def _take_window(
    array: NDArray[Any], top: int, left: int, window: tuple[int, int], fill: object
) -> NDArray[Any]:
    height, width = window
    inner = array[max(top, 0) : top + height, max(left, 0) : left + width]
    if inner.shape[:2] == window:
        return np.ascontiguousarray(inner)
    out = np.empty((height, width, *array.shape[2:]), dtype=array.dtype)
    out[...] = fill
    row, column = max(-top, 0), max(-left, 0)
    out[row : row + inner.shape[0], column : column + inner.shape[1]] = inner
    return out


def choose_crop(
    semantic: NDArray[np.uint8],
    window: tuple[int, int],
    offsets: Sequence[tuple[int, int]],
    classes: Sequence[int],
) -> tuple[int, int]:
    """Return the offset (top, left) whose window has most pixels of the classes.

    Ties keep the first, so that frames without labels are cut at random.

    Args:
        semantic: uint8 (H, W), class ids.
        window: (height, width) [px]; larger than the image, it covers it.
        offsets: the candidates.
        classes: ids of the rare classes.
    """
    if len(offsets) == 1:
        return offsets[0]
    is_rare = np.zeros(256, np.bool_)
    is_rare[list(classes)] = True
    rare = is_rare[semantic]
    height, width = window

    def count(offset: tuple[int, int]) -> int:
        top, left = offset
        return int(rare[max(top, 0) : top + height, max(left, 0) : left + width].sum())

    return max(offsets, key=count)


def with_crop(augment: AugmentConfig, smallest: tuple[int, int]) -> AugmentConfig:
    """Return the ranges with a crop: as high as the smallest frame, up to `LARGEST_CROP`.

    Raises:
        InputError: if that is too small for second views.
    """
    if augment.crop is not None:
        return augment
    sides = np.minimum(smallest, LARGEST_CROP) // _CROP_STEP * _CROP_STEP
    height, width = (max(MIN_SIDE, int(side)) for side in sides)
    crop = (height, min(width, height * LARGEST_CROP[1] // LARGEST_CROP[0]))
    try:
        return replace(augment, crop=crop)
    except ValueError as error:
        raise InputError(
            f"data.augment.crop was set to {list(crop)} from the size of the data; with "
            f"pair_shift = {augment.pair_shift} the two views would not overlap: set it to a "
            "larger size"
        ) from error
