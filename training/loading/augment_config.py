"""The ranges and probabilities of the augmentation, and the crop that follows from the data."""

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import InputError
from runtime.contract.contract import MIN_SIDE
from training.base.limits import STRICT, CropSide, Degrees, FactorRange, Share, ShareRange, Strength

# Default crop. Smaller data has a smaller crop, see `with_crop`.
LARGEST_CROP = (320, 480)
# Width of the border [px] of each of two views that is not compared, because padding changes
# answers there.
PAIR_BORDER_PX = 32
# Least step [px] of the shift between two views; the stride of the semantic logits, if larger.
PAIR_STEP_PX = 4
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
        restyle: probability that the histograms of an image's channels move towards those of an
            image of any set, all sets alike, by a random share.
        lidar_missing: probability that the LiDAR is missing.
        lidar_random: probability that the input is a random share of the measurements instead of
            scan lines.
        random_share: range of the random share, log-uniform. For dense depth it is a share of the
            pixels; for recorded returns see `training.loading.lidar_input`.
        lines: numbers of scan lines to choose from. A recorded scan keeps every 64/n-th line. 128
            lines need dense depth, otherwise 64 are used.
        lidar_misaligned: probability of an error of the LiDAR's extrinsics; ignored without
            intrinsics.
        lidar_dropout: probability that one to three sectors of the LiDAR are missing.
        lidar_absorbed: probability that one labelled object, such as a car, or its upper part has
            no returns.
        camera_fault: probability of a fault of the camera, see `training.loading.camera_faults`.
        camera_fault_strength: the greatest strength of such a fault.
        world_scale: range of a random factor of all depth in frames with LiDAR input, so that the
            network takes the scale from the returns instead of the image. (1, 1) changes nothing.
        pair_shift: largest shift [px] of a second view of each frame, for the consistency losses.
            Shifts are multiples of the stride of the semantic head. 0: there is one view.
        pair_lidar_missing: probabilities that the second view has no LiDAR, and that it has false
            returns.
        pair_camera_fault: probability of a fault of the camera in the second view alone.
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
    restyle: Share = 0.0
    lidar_missing: Share = 0.1
    lidar_random: Share = 0.3
    random_share: ShareRange = (0.01, 0.08)
    lines: Annotated[
        tuple[Literal[1, 2, 4, 8, 16, 32, 64, 128], ...], Field(min_length=1, max_length=100)
    ] = (64, 32, 16)
    lidar_misaligned: Share = 0.0
    lidar_dropout: Share = 0.0
    lidar_absorbed: Share = 0.0
    camera_fault: Share = 0.0
    camera_fault_strength: Share = 1.0
    world_scale: FactorRange = (1.0, 1.0)
    pair_shift: Annotated[int, Field(ge=0, le=128, multiple_of=PAIR_STEP_PX)] = 0
    pair_lidar_missing: Share = 0.0
    pair_lidar_false: Share = 0.0
    pair_camera_fault: Share = 0.0

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

    @property
    def drawn_size(self) -> tuple[int, int]:
        """(height, width) of what is drawn, which has room for both views."""
        return self.size[0] + self.pair_shift, self.size[1] + self.pair_shift


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
