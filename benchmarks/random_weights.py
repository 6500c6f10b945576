"""Writes networks with random weights, which are as fast as trained ones, for ssdnet-bench.

    python benchmarks/random_weights.py DIR ddrnet-23-slim fast-scnn

Our own networks have the outputs that `ssdnet-export` gives them, and depth networks of others
return metres. Semantic networks of others end in scores of 19 classes at full size, because papers
time them so. The program prints the parameters of each network, and its multiplications with
addition at 512 x 1024.
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor

from export.build import count_giga_macs
from export.deploy import DeployGraph
from export.trace import trace
from models import SSDNetConfig, SSDNetLiteConfig, create_model
from models.blocks import upsample
from models.classes import numbered_classes
from models.registry import NETWORKS
from runtime.files.atomic_write import atomic_write

# Number of classes of Cityscapes, for which the others' networks were published.
NUM_CLASSES = 19
# Size at which graphs are traced; exported graphs take any size.
TRACED_AT = (128, 416)
# Size at which multiplications are counted.
COUNTED_AT = (512, 1024)


class LogitsGraph(DeployGraph):
    """A graph from pixels to the scores of every class at full size."""

    @property
    def heads(self) -> tuple[str, ...]:
        """The only output."""
        return ("semantic_logits",)

    def forward(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, ...]:
        """Uint8 (N, H, W, 3) and float32 (N, H, W) -> float32 (N, C, H, W)."""
        height, width = rgb.shape[1], rgb.shape[2]
        coarse = self.model.predict_coarse(
            rgb.permute(0, 3, 1, 2).to(torch.float32), sparse_depth.unsqueeze(1)
        )
        logits = upsample(coarse.semantic_logits, factor=self.model.semantic_stride)
        return (logits[:, :, :height, :width],)


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("names", nargs="+", choices=list(NETWORKS), metavar="NAME")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in arguments.names:
        graph = random_graph(name)
        atomic_write(arguments.folder / f"{name}.onnx", export_graph(graph))
        params_m = sum(weights.numel() for weights in graph.model.parameters()) / 1e6
        print(f"{name}: {params_m:.3g} M parameters", end=", ")
        print(f"{count_giga_macs(graph.model, COUNTED_AT):.3g} GMACs")


def random_graph(name: str) -> DeployGraph:
    """Build a network with random weights."""
    torch.manual_seed(0)
    entry = NETWORKS[name]
    if isinstance(entry.config, SSDNetConfig | SSDNetLiteConfig) or not entry.config.classes:
        return DeployGraph(create_model(name).eval())
    return LogitsGraph(create_model(name, classes=numbered_classes(NUM_CLASSES)).eval())


def export_graph(graph: DeployGraph) -> bytes:
    """Return the ONNX file of a graph for any size, without metadata."""
    return trace(graph, size=TRACED_AT, dynamic=True).SerializeToString()


if __name__ == "__main__":
    main()
