"""Draws the paper's network and `ssdnet-lite` as their modules compute them: docs/network.png.

    python benchmarks/network_figure.py [MODEL ...] [--out docs/network.png]

A frame runs through each network. Every box is the output of a module, with its number of channels,
in the row of its stride; an arrow leads from a box to each box that is computed from it without
another box between them. The picture is drawn from the networks themselves, so that it stays true.
"""

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

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
            "depth_heads",
            "surface_depth.refinement",
            "surface_depth.head",
            "surface_depth.coarse_head",
            "surface_depth.guess",
            "surface_depth",
        ),
    ),
)
# The modules that are drawn are whole blocks, not their layers: so many names are joined in theirs.
_DEPTH = {"encoder": 2, "semantic_decoder": 3, "depth_decoder": 3, "boundary_decoder": 3}
_DEPTH |= {"depth_heads": 2}
_OF_PAPER = {**_DEPTH, "encoder": 3}

# What the label of a box leaves out of the name of its module.
_LABEL = re.compile(r"^(encoder|(boundary|semantic|depth)_decoder|semantic|surface_depth)[._]")


class Box(NamedTuple):
    """The output of a module.

    Attributes:
        column: number in COLUMNS.
        stride: stride of its grid.
        channels: number of channels.
        name: name of the module.
        output: the output, with the graph by which it was computed.
    """

    column: int
    stride: int
    channels: int
    name: str
    output: Tensor


def find_boxes(network: nn.Module) -> list[Box]:
    """Run a frame and return the outputs of the network's modules, in the order of execution.

    The candidates of the depth, which no module computes, are those that the depth head gets.
    """
    boxes: list[Box] = []

    def add(name: str, column: int, output: object) -> None:
        if isinstance(output, tuple | list):
            output = output[0]
        if isinstance(output, Tensor) and output.ndim == 4 and output.shape[2] > 1:
            stride = SIZE[0] // output.shape[2]
            boxes.append(Box(column, stride, output.shape[1], name, output))

    def watch(name: str, column: int, module: nn.Module) -> None:
        module.register_forward_hook(lambda _module, _inputs, output: add(name, column, output))

    def add_candidates(_module: nn.Module, inputs: tuple[Candidates, ...]) -> None:
        executed = boxes.copy()
        boxes.clear()
        add("returns", 0, inputs[0].sparse_depth)
        add("base", 0, inputs[0].inverse_base)
        add("surfaces", 0, inputs[0].features)
        boxes.extend(executed)

    depths = _DEPTH
    if (depth_head := getattr(network, "surface_depth", None)) is not None:
        depth_head.register_forward_pre_hook(add_candidates)
    else:
        depths = _OF_PAPER
    for name, module in network.named_modules():
        for column, (_, starts) in enumerate(COLUMNS):
            start = next((s for s in starts if name == s or name.startswith(f"{s}.")), None)
            if start is not None and name.count(".") + 1 == depths.get(start, start.count(".") + 1):
                watch(name, column, module)
    depth = torch.zeros(1, 1, *SIZE)
    depth[..., ::4, ::4] = 10
    network.eval()(torch.zeros(1, 3, *SIZE), depth.requires_grad_())
    return boxes


def find_arrows(boxes: list[Box]) -> Iterator[tuple[Box, Box]]:
    """Yield (from, to) for each box that another one is computed from directly."""
    of_nodes = {box.output.grad_fn: box for box in boxes if box.output.grad_fn is not None}
    for box in boxes:
        waiting: list[Any] = [box.output.grad_fn]
        seen, found = set(), set()
        while waiting:
            node = waiting.pop()
            if node is None or node in seen:
                continue
            seen.add(node)
            if (source := of_nodes.get(node)) is not None and source is not box:
                if source.name not in found:
                    yield source, box
                found.add(source.name)
            else:
                waiting += [following for following, _ in node.next_functions]


def draw(boxes: list[Box], axes: Any, title: str) -> None:
    """Draw the boxes, with a column for each part of the network and a row for each stride."""
    cells: dict[tuple[int, int], list[Box]] = {}
    patches: dict[str, plt.Rectangle] = {}
    for box in boxes:
        cells.setdefault((box.column, box.stride), []).append(box)
    for (column, stride), found in cells.items():
        row = STRIDES.index(stride)
        width = 0.8 / len(found)
        for place, box in enumerate(found):
            left = column - 0.4 + place * width
            color = plt.colormaps["tab10"](column)
            frame = (left, row - 0.26), width * 0.92, 0.52
            axes.add_patch(plt.Rectangle(*frame, color="white", zorder=2))
            patches[box.name] = plt.Rectangle(*frame, color=color, alpha=0.35, zorder=2)
            axes.add_patch(patches[box.name])
            middle = left + width * 0.46
            axes.text(middle, row - 0.09, str(box.channels), ha="center", va="center", zorder=3)
            label = _LABEL.sub("", box.name).replace(".", " ").replace("_", " ")
            axes.text(middle, row + 0.16, label, ha="center", va="center", fontsize=5.5, zorder=3)
    for source, box in find_arrows(boxes):
        ends = patches[source.name], patches[box.name]
        arrow = {"arrowstyle": "-|>", "mutation_scale": 6, "lw": 0.7, "alpha": 0.8, "shrinkB": 0}
        arrow |= {"color": plt.colormaps["tab10"](source.column), "patchA": ends[0]}
        arrow |= {"patchB": ends[1], "connectionstyle": "arc3,rad=0.12"}
        start, end = (patch.get_center() for patch in ends)
        axes.annotate("", end, start, arrowprops=arrow, zorder=1)
    axes.set_xlim(-0.6, len(COLUMNS) - 0.4)
    axes.set_ylim(len(STRIDES) - 0.5, -0.5)
    columns = sorted({box.column for box in boxes})
    axes.set_xticks(columns, [COLUMNS[column][0] for column in columns])
    axes.set_yticks(range(len(STRIDES)), [f"stride {stride}" for stride in STRIDES])
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(title, fontsize=10)


def main() -> None:
    """Draw the figure of some networks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=["ssdnet", "ssdnet-lite"])
    parser.add_argument("--out", type=Path, default=Path("docs/network.png"))
    arguments = parser.parse_args()
    count = len(arguments.models)
    figure, axes = plt.subplots(count, figsize=(12, 6.2 * count), dpi=90, squeeze=False)
    for model, each in zip(arguments.models, axes.flat, strict=True):
        draw(find_boxes(create_model(model)), each, f"{model}: channels of each module's output")
    figure.tight_layout()
    plt.savefig(arguments.out)
    print(arguments.out)


if __name__ == "__main__":
    main()
