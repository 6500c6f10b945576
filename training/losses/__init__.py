"""The losses of the paper, Eq. 2-12, and soft IoU; a file a family, summed by `SSDNetLoss`."""

from training.losses.semantic import class_weights
from training.losses.total import LossConfig, SSDNetLoss

__all__ = ["LossConfig", "SSDNetLoss", "class_weights"]
