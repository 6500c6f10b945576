"""The LiDAR input that is drawn for a sample: which returns, and the faults of the sensor."""

from dataclasses import replace

from numpy.random import Generator

from training.datasets.sample import Sample
from training.lidar.faults import absorb, drop_sectors, misalign
from training.lidar.simulate import SENSOR_LINES
from training.lidar.split import LidarInput, split_lidar
from training.loading.augment_config import AugmentConfig
from training.loading.depth_values import has_dense_depth

# Like `AugmentConfig.random_share`, but for recorded returns instead of pixels.
_RECORDED_SHARE = (0.05, 0.8)


def draw_lidar(sample: Sample, config: AugmentConfig, rng: Generator) -> Sample:
    """Choose the LiDAR input and the depth target, see `training.lidar.split`.

    Faults of the LiDAR come with their probabilities.
    """
    lidar = _choose_lidar(sample, config, rng)
    first_line = int(rng.integers(SENSOR_LINES))
    if lidar.lines > SENSOR_LINES:  # more than any recorded scan has: simulated
        sample = replace(sample.with_returns(None), scan_line=None)
    split = split_lidar(sample, lidar, rng, same_target=False, first_line=first_line)
    assert split is not None  # `_choose_lidar` takes what the sample has
    fed, intrinsics = split.fed, sample.intrinsics
    is_misaligned = config.lidar_misaligned and rng.random() < config.lidar_misaligned
    if is_misaligned and intrinsics is not None and fed.any():
        fed = misalign(fed, intrinsics, rng)
    if config.lidar_dropout and rng.random() < config.lidar_dropout:
        fed = drop_sectors(fed, rng)
    if config.lidar_absorbed and rng.random() < config.lidar_absorbed:
        fed = absorb(fed, sample.semantic, rng)
    return sample.with_returns(fed).with_targets(depth=split.target)


def _choose_lidar(sample: Sample, config: AugmentConfig, rng: Generator) -> LidarInput:
    """Choose no input, a random share of the measurements, scan lines, or the recorded input."""
    missing = rng.random() < config.lidar_missing
    random = rng.random() < config.lidar_random
    lines = int(rng.choice(config.lines))
    if lines > SENSOR_LINES and (sample.intrinsics is None or not has_dense_depth(sample)):
        lines = SENSOR_LINES
    is_recorded = sample.returns is not None
    if missing:
        return LidarInput("none")
    if random or not (is_recorded or sample.intrinsics is not None):
        low, high = _RECORDED_SHARE if is_recorded else config.random_share
        share = low * (high / low) ** rng.random()  # log-uniform: few returns as often as many
        return LidarInput("random", share=share)
    if is_recorded and sample.scan_line is None and lines <= SENSOR_LINES:
        return LidarInput("own")
    if sample.is_scan:
        # All lines of the sensor would leave no target: at least every second is withheld.
        lines = min(lines, SENSOR_LINES // 2)
    return LidarInput("lines", lines=lines)
