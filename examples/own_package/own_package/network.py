"""A network that answers the new head alone, on half of the image's grid."""

import torch
from torch import Tensor, nn

from models import Network, NetworkConfig, NetworkOutput
from models.blocks import pad_to_multiple
from models.registry import Entry


class OwnNetwork(Network):
    """One convolution of the image and the sparse depth."""

    heads = ("drivable",)
    stride = 2
    drivable_stride = 2

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.layer = nn.Conv2d(4, 1, 3, stride=2, padding=1)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """See `Network.predict_coarse`."""
        depth, _ = self.normalise_depth(sparse_depth)
        inputs = torch.cat((self.normalise_rgb(rgb), depth), dim=1)
        return NetworkOutput(others={"drivable": self.layer(pad_to_multiple(inputs, 2))})


NETWORK = Entry(OwnNetwork, NetworkConfig("own-network", classes=()))
