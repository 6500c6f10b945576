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
from models.baselines.sparse_conv import SparseConvNet
from models.baselines.sparse_to_dense import SparseToDense
from models.network import Network, NetworkConfig, check_fields
from models.ssdnet import SSDNETS, SSDNet
from models.ssdnet_lite import SSDNET_NANO, SSDNetLite, SSDNetLiteConfig
from runtime.base.arguments import shown
from runtime.base.entry_points import find_entry, list_entries


class Entry(NamedTuple):
    """A network's class and its default configuration.

    Attributes:
        network: class whose only argument is the configuration.
        config: the default configuration.
    """

    network: type[Network]
    config: NetworkConfig


# Name -> network. A new network needs a line here, or an entry point of another package.
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
    "sparse-conv": Entry(SparseConvNet, NetworkConfig("sparse-conv", classes=())),
    "sparse-to-dense": Entry(SparseToDense, NetworkConfig("sparse-to-dense", classes=())),
}


# The entry points of networks in other packages.
GROUP = "ssdnet.networks"


def list_models() -> list[str]:
    """Return the names for `create_model`."""
    return list_entries(GROUP, NETWORKS)


def find_network(name: str) -> Entry:
    """Return the class and the default configuration of a network.

    Raises ValueError for a name that neither this package nor an installed one registers.
    """
    entry = find_entry(GROUP, name, Entry, NETWORKS)
    if entry is None:
        raise ValueError(f"unknown model {shown(name)}; known: {', '.join(list_models())}")
    return entry


def registered_name(network: Network) -> str:
    """Return the name under which a network's class is registered.

    It is the name of its configuration, or that of another configuration of the same class.

    Raises ValueError if its class is registered nowhere.
    """
    wanted = network.config.name
    entry = find_entry(GROUP, wanted, Entry, NETWORKS)
    if entry is not None and entry.network is type(network):
        return wanted
    names = (name for name, other in NETWORKS.items() if other.network is type(network))
    if (name := next(names, None)) is None:
        raise ValueError(
            f"the class {type(network).__name__} of the network {shown(wanted)} is not registered: "
            f"add it to models.registry.NETWORKS, or as an entry point of {GROUP}"
        )
    return name


def create_model(name: str, **changes: Any) -> Network:
    """Build a network by name, with random weights.

    Args:
        name: one of `list_models`.
        **changes: fields of the network's configuration, for example a tuple `classes`,
            `max_depth_m`, or `boundary_gating=False` of `SSDNetConfig`.

    Returns:
        The network in training mode, on the CPU.

    Raises:
        ValueError: for an unknown name, for classes on a network without a semantic head, and for a
            field that the network does not have.
    """
    network, config = find_network(name)
    check_fields(type(config), changes, name)
    return network(replace(config, **changes))
