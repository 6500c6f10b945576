"""The first step of an export: a checkpoint becomes a graph with its metadata."""

import copy
import hashlib
import itertools
from dataclasses import dataclass
from pathlib import Path

import onnx
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from export.deploy import DeployGraph
from export.errors import ExportError
from export.options import ExportOptions
from export.trace import trace
from models import Checkpoint, Network, load_checkpoint
from models.answers import check_output
from runtime import Contract, __version__
from runtime.contract.contract import SCHEMA_VERSION
from runtime.contract.model_file import with_contract


@dataclass(frozen=True)
class Draft:
    """A graph with its metadata, beside the network whose answers it must give.

    Attributes:
        network: the network.
        heads: names of the graph's outputs.
        model: the graph.
        contract: the metadata.
        dynamic: whether the graph takes any size.
    """

    network: Network
    heads: tuple[str, ...]
    model: onnx.ModelProto
    contract: Contract
    dynamic: bool

    def write(self, path: Path) -> int:
        """Write graph and metadata, which hold the digest of the rest; return the size.

        Raises ExportError for facts about the training that JSON cannot hold.
        """
        del self.model.metadata_props[:]
        try:
            content = with_contract(self.model.SerializeToString(), self.contract)
        except (TypeError, ValueError, RecursionError) as error:
            raise ExportError(
                f"the checkpoint's facts about its training are not plain JSON: {error}"
            ) from error
        return path.write_bytes(content)


def read_checkpoint(path: Path) -> Checkpoint:
    """Return a checkpoint whose weights are finite and whose network returns what it declares."""
    checkpoint = load_checkpoint(path)
    _require_finite(checkpoint.model)
    try:
        check_output(checkpoint.model)
    except ValueError as error:
        raise ExportError(f"{path}: {error}") from error
    return checkpoint


def build_draft(checkpoint: Checkpoint, options: ExportOptions) -> Draft:
    """Trace the network of a checkpoint, and describe it."""
    network, config, size = checkpoint.model, checkpoint.model.config, options.native_size
    graph = DeployGraph(network, with_logits=options.with_logits)
    model = trace(graph, size=size, dynamic=options.any_size, opset=options.opset)
    with options.source.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    contract = Contract(
        schema_version=SCHEMA_VERSION,
        model_name=options.model_name or config.name,
        classes=config.classes,
        max_depth_m=config.max_depth_m,
        native_size=size,
        stride=network.stride,
        precision="fp32",
        training=dict(checkpoint.training),
        versions={
            "ssdnet": __version__,
            "torch": str(torch.__version__),
            "onnx": str(onnx.__version__),
            "opset": str(options.opset),
        },
        parity={},
        checkpoint_sha256=digest,
        trained_height=checkpoint.facts.trained_height,
        canonical_focal_px=config.canonical_focal_px,
        giga_macs=count_giga_macs(network, size),
    )
    return Draft(network, graph.heads, model, contract, options.any_size)


def count_giga_macs(model: Network, size: tuple[int, int]) -> float:
    """Count the multiplications with addition of a frame of `size` (height, width), in billions."""
    inputs = (torch.empty(1, channels, *size, device="meta") for channels in (3, 1))
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        copy.deepcopy(model).to("meta")(*inputs)
    return float(counter.get_total_flops()) / 2e9  # a multiplication and an addition count as two


def _require_finite(model: nn.Module) -> None:
    """Raise ExportError with the names of the weights and buffers that hold NaN or Inf."""
    bad = [
        name
        for name, values in itertools.chain(model.named_parameters(), model.named_buffers())
        if not bool(torch.isfinite(values).all())
    ]
    if bad:
        raise ExportError(
            f"the checkpoint holds NaN or Inf in {', '.join(bad[:5])}"
            + (f" and {len(bad) - 5} more" if len(bad) > 5 else "")
            + ", so nothing was written: use a checkpoint from before the training diverged"
        )
