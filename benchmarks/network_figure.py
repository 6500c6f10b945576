"""Draws the grids of `ssdnet-lite` as its modules compute them: docs/network.png.

    python benchmarks/network_figure.py [MODEL] [--out docs/network.png]

A frame runs through the network. Every box is the output of a module, with its number of channels,
in the row of its stride. The picture is drawn from the network itself, so that it stays true.
"""

import argparse
import re
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
from torch import Tensor, nn

from models import create_model
from models.surfaces import Candidates

SIZE = (64, 96)
STRIDES = (1, 2, 4, 8, 16, 32)
# Titles of the columns, and the beginnings of the names of the modules in each.
COLUMNS = (
    ("LiDAR", ("surface_depth.embed", "surface_depth.geometry")),
    ("encoder", ("encoder", "context")),
    ("boundary", ("boundary_decoder.fuse", "boundary_decoder")),
    ("classes", ("semantic_decoder", "semantic_refine", "semantic_head", "semantic_coarse_head")),
    (
        "depth",
        (
            "depth_decoder",
            "surface_depth.refinement",
            "surface_depth.head",
            "surface_depth.coarse_head",
            "surface_depth.guess",
            "surface_depth",
        ),
    ),
)
# The modules that are drawn: whole blocks, not their layers.
_DEPTH = {"encoder": 2, "semantic_decoder": 3, "depth_decoder": 3, "boundary_decoder": 3}


# What the label of a box leaves out of the name of its module.
_LABEL = re.compile(r"^(encoder|(boundary|semantic|depth)_decoder|semantic|surface_depth)[._]")


class Box(NamedTuple):
    """The output of a module.

    Attributes:
        column: number in COLUMNS.
        stride: stride of its grid.
        channels: number of channels.
        name: name of the module.
    """

    column: int
    stride: int
    channels: int
    name: str


def find_boxes(network: nn.Module) -> list[Box]:
    """Run a frame and return the outputs of the network's modules, in the order of execution.

    The candidates of the depth, which no module computes, are those that the depth head gets.
    """
    boxes: list[Box] = []

    def add(name: str, column: int, output: object) -> None:
        if isinstance(output, tuple | list):
            output = output[0]
        if isinstance(output, Tensor) and output.ndim == 4 and output.shape[2] > 1:
            boxes.append(Box(column, SIZE[0] // output.shape[2], output.shape[1], name))

    def watch(name: str, column: int, module: nn.Module) -> None:
        module.register_forward_hook(lambda _module, _inputs, output: add(name, column, output))

    def add_candidates(_module: nn.Module, inputs: tuple[Candidates, ...]) -> None:
        executed = boxes.copy()
        boxes.clear()
        add("returns", 0, inputs[0].sparse_depth)
        add("base", 0, inputs[0].inverse_base)
        add("surfaces", 0, inputs[0].features)
        boxes.extend(executed)

    if (depth_head := getattr(network, "surface_depth", None)) is not None:
        depth_head.register_forward_pre_hook(add_candidates)

    for name, module in network.named_modules():
        for column, (_, starts) in enumerate(COLUMNS):
            start = next((s for s in starts if name == s or name.startswith(f"{s}.")), None)
            if start is not None and name.count(".") + 1 == _DEPTH.get(start, start.count(".") + 1):
                watch(name, column, module)
    depth = torch.zeros(1, 1, *SIZE)
    depth[..., ::4, ::4] = 10
    with torch.no_grad():
        network.eval()(torch.zeros(1, 3, *SIZE), depth)
    return boxes


def draw(boxes: list[Box], path: Path, title: str) -> None:
    """Draw the boxes, with a column for each part of the network and a row for each stride."""
    _, axes = plt.subplots(figsize=(12, 5.4), dpi=100)
    cells: dict[tuple[int, int], list[Box]] = {}
    for box in boxes:
        cells.setdefault((box.column, box.stride), []).append(box)
    for (column, stride), found in cells.items():
        row = STRIDES.index(stride)
        width = 0.9 / len(found)
        for place, box in enumerate(found):
            left = column - 0.45 + place * width
            color = plt.colormaps["tab10"](column)
            axes.add_patch(
                plt.Rectangle((left, row - 0.34), width * 0.92, 0.68, color=color, alpha=0.35)
            )
            middle = left + width * 0.46
            axes.text(middle, row - 0.12, str(box.channels), ha="center", va="center")
            label = _LABEL.sub("", box.name).replace(".", " ").replace("_", " ")
            axes.text(middle, row + 0.2, label, ha="center", va="center", fontsize=5.5)
    axes.set_xlim(-0.6, len(COLUMNS) - 0.4)
    axes.set_ylim(len(STRIDES) - 0.4, -0.6)
    axes.set_xticks(range(len(COLUMNS)), [name for name, _ in COLUMNS])
    axes.set_yticks(range(len(STRIDES)), [f"stride {stride}" for stride in STRIDES])
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(title, fontsize=10)
    plt.savefig(path, bbox_inches="tight")
    plt.close()


def main() -> None:
    """Draw the figure of a network."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", default="ssdnet-lite")
    parser.add_argument("--out", type=Path, default=Path("docs/network.png"))
    arguments = parser.parse_args()
    network = create_model(arguments.model)
    title = f"{arguments.model}: channels of each module's output, in the order of execution"
    draw(find_boxes(network), arguments.out, title)
    print(arguments.out)


if __name__ == "__main__":
    main()
