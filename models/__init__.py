"""The networks, and nothing else.

>>> from models import create_model
>>> network = create_model("ssdnet-lite")
"""

from models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from models.classes import CAMVID_CLASSES, CLASS_TABLES
from models.network import Network, NetworkConfig, NetworkOutput
from models.registry import create_model, list_models
from models.ssdnet import SSDNet, SSDNetConfig
from models.ssdnet_lite import SSDNetLite, SSDNetLiteConfig

__all__ = [
    "CAMVID_CLASSES",
    "CLASS_TABLES",
    "Checkpoint",
    "Network",
    "NetworkConfig",
    "NetworkOutput",
    "SSDNet",
    "SSDNetConfig",
    "SSDNetLite",
    "SSDNetLiteConfig",
    "create_model",
    "list_models",
    "load_checkpoint",
    "save_checkpoint",
]
