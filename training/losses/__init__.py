"""The losses of the paper, Eq. 2-12, one file a family; `SSDNetLoss` is their weighted sum."""

from training.losses.semantic import class_weights
from training.losses.total import LossConfig, SSDNetLoss

__all__ = ["LossConfig", "SSDNetLoss", "class_weights"]
