"""All networks by name."""

from dataclasses import replace
from typing import Any, NamedTuple

from models.baselines.bacnn import BaCNN
from models.baselines.ddrnet_23_slim import DDRNet23Slim
from models.baselines.deeplab_largefov import DeepLabLargeFOV
from models.baselines.enet import ENet
from models.baselines.erfnet import ERFNet
from models.baselines.espnet import ESPNet
from models.baselines.fast_scnn import FastSCNN
from models.baselines.fcn8s import FCN8s
from models.baselines.nconv import NConv
from models.baselines.pidnet_s import PIDNetS
from models.baselines.sparse_conv import SparseConvNet
from models.baselines.sparse_to_dense import SparseToDense
from models.network import Network, NetworkConfig, check_fields
from models.paper.config import SSDNETS
from models.paper.ssdnet import SSDNet
from models.ssdnet_lite import SSDNET_NANO, SSDNetLite, SSDNetLiteConfig


class Entry(NamedTuple):
    """A network's class and its default configuration."""

    #: Its only argument is the configuration.
    network: type[Network]
    config: NetworkConfig


#: Name -> network; a new network is a line here.
NETWORKS: dict[str, Entry] = {
    **{config.name: Entry(SSDNet, config) for config in SSDNETS},
    "ssdnet-lite": Entry(SSDNetLite, SSDNetLiteConfig()),
    "ssdnet-nano": Entry(SSDNetLite, SSDNET_NANO),
    "bacnn": Entry(BaCNN, NetworkConfig("bacnn")),
    "ddrnet-23-slim": Entry(DDRNet23Slim, NetworkConfig("ddrnet-23-slim")),
    "deeplab-largefov": Entry(DeepLabLargeFOV, NetworkConfig("deeplab-largefov")),
    "enet": Entry(ENet, NetworkConfig("enet")),
    "erfnet": Entry(ERFNet, NetworkConfig("erfnet")),
    "espnet": Entry(ESPNet, NetworkConfig("espnet")),
    "fast-scnn": Entry(FastSCNN, NetworkConfig("fast-scnn")),
    "fcn8s": Entry(FCN8s, NetworkConfig("fcn8s")),
    "nconv": Entry(NConv, NetworkConfig("nconv", classes=())),
    "pidnet-s": Entry(PIDNetS, NetworkConfig("pidnet-s")),
    "sparse-conv": Entry(SparseConvNet, NetworkConfig("sparse-conv", classes=())),
    "sparse-to-dense": Entry(SparseToDense, NetworkConfig("sparse-to-dense", classes=())),
}


def list_models() -> list[str]:
    """Return the names for `create_model`."""
    return list(NETWORKS)


def create_model(name: str, **changes: Any) -> Network:
    """Build a network by name, with random weights.

    Args:
        name: one of `list_models`.
        **changes: fields of the network's configuration, for example a tuple ``classes``,
            ``max_depth_m``, or ``boundary_gating=False`` of `SSDNetConfig`.

    Returns:
        The network in training mode, on the CPU.

    Raises:
        ValueError: for an unknown name, for classes on a network without a semantic head, and for a
            field that the network does not have.
    """
    if name not in NETWORKS:
        raise ValueError(f"unknown model {name!r}; known: {', '.join(NETWORKS)}")
    network, config = NETWORKS[name]
    check_fields(type(config), changes, name)
    return network(replace(config, **changes))
