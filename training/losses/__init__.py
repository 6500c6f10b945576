"""The losses of the paper, Eq. 2-12, soft IoU and Lovász; `SSDNetLoss` combines them."""

from training.losses.semantic import class_weights
from training.losses.total import LossConfig, SSDNetLoss

__all__ = ["LossConfig", "SSDNetLoss", "class_weights"]
