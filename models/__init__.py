"""The networks of the SSDNet family, and nothing else.

>>> from models import create_model
>>> network = create_model("ssdnet-lite")
"""

from collections.abc import Sequence
from dataclasses import replace

from models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from models.classes import CAMVID_CLASSES, CLASS_TABLES, numbered_classes
from models.config import CONFIGS, ModelConfig
from models.ssdnet import SSDNet, SSDNetOutput
from runtime.contract import ClassInfo

__all__ = [
    "CAMVID_CLASSES",
    "CLASS_TABLES",
    "Checkpoint",
    "ModelConfig",
    "SSDNet",
    "SSDNetOutput",
    "create_model",
    "list_models",
    "load_checkpoint",
    "save_checkpoint",
]


def list_models() -> list[str]:
    """Return the names that `create_model` knows."""
    return list(CONFIGS)


def create_model(
    name: str,
    *,
    classes: Sequence[ClassInfo] | None = None,
    num_classes: int | None = None,
    max_depth_m: float | None = None,
    boundary_gating: bool = True,
    sparse_depth_gain: float = 1.0,
) -> SSDNet:
    """Build a network by name, with random weights.

    ``classes`` (or ``num_classes`` for numbered ones) replaces CamVid's eleven; ``max_depth_m`` is
    the depth range in metres; without ``boundary_gating`` the decoders ignore the boundary;
    ``sparse_depth_gain`` multiplies the sparse depth at the input.
    Raises ValueError for an unknown name, for both kinds of classes at once, or for classes on a
    network without a semantic head.
    """
    if name not in CONFIGS:
        raise ValueError(f"unknown model {name!r}; known: {', '.join(CONFIGS)}")
    config = CONFIGS[name]
    if classes is not None and num_classes is not None:
        raise ValueError("give classes or num_classes, not both")
    if num_classes is not None:
        classes = numbered_classes(num_classes)
    if classes is not None:
        config = replace(config, classes=tuple(classes))
    if max_depth_m is not None:
        config = replace(config, max_depth_m=max_depth_m)
    return SSDNet(
        replace(config, boundary_gating=boundary_gating, sparse_depth_gain=sparse_depth_gain)
    )
