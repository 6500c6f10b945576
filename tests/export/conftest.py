"""Small members of every variant of the family, for tests that trace or run them."""

import copy
from dataclasses import replace

import onnx
import pytest
import torch
from onnx.utils import Extractor

from export import exporter
from export.deploy import DeployGraph
from export.exporter import export_checkpoint
from export.probe_frames import probe_frames
from export.trace import INPUTS, trace
from models import Network, NetworkConfig, SSDNetLite, SSDNetLiteConfig, save_checkpoint
from models.registry import NETWORKS

SIZE = (64, 96)

# Two workers with two threads each wait for one another.
torch.set_num_threads(1)


def small_config(name: str) -> NetworkConfig:
    """The named variant with few channels and one block a stage."""
    config = NETWORKS[name].config
    if name == "ssdnet-lite":
        return SSDNetLiteConfig(
            encoder_widths=(16,) * 16,
            decoder_channels=(16, 16, 16),
            semantic_refine_channels=0,
            geometry_channels=8,
        )
    return replace(
        config,
        encoder_channels=(8, 16),
        encoder_blocks=(1, 1),
        decoder_channels=(8, 8),
        boundary_channels=4,
    )


def build_small(name: str) -> Network:
    """A network whose batch norms have seen pictures, so that its answers vary."""
    torch.manual_seed(0)
    model = NETWORKS[name].network(small_config(name)).train()
    if isinstance(model, SSDNetLite):  # made for a pretrained encoder, it learns slowly
        for layer in model.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.momentum = 0.1
    frames = probe_frames(SIZE, max_depth_m=model.config.max_depth_m)[:4]  # without faults
    with torch.no_grad():
        for _ in range(10):
            model(
                torch.stack([torch.from_numpy(f.rgb).permute(2, 0, 1).float() for f in frames]),
                torch.stack([torch.from_numpy(f.sparse_depth)[None] for f in frames]),
            )
    return model.eval()


@pytest.fixture(scope="session")
def lite() -> Network:
    return build_small("ssdnet-lite")


@pytest.fixture(scope="session")
def lite_checkpoint(lite, tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "lite.pt"
    save_checkpoint(path, lite, training={"data": ["made-up frames"], "terms": "none"})
    return path


@pytest.fixture(scope="session")
def beside(tmp_path_factory):
    """The folder with the `recording` and the Triton `repository` of `exported`."""
    return tmp_path_factory.mktemp("beside")


@pytest.fixture(scope="session")
def dynamic_model(lite):
    """The graph of any size, with logits."""
    return trace(DeployGraph(lite, with_logits=True), size=SIZE, dynamic=True)


@pytest.fixture(scope="session")
def fixed_graph(dynamic_model):
    """The same graph without logits, for frames of SIZE alone: to trace it takes as long again."""
    heads = [tensor.name for tensor in dynamic_model.graph.output[:-1]]
    model = Extractor(copy.deepcopy(dynamic_model)).extract_model(list(INPUTS), heads)
    del model.graph.value_info[:]
    for tensor in (*model.graph.input, *model.graph.output):
        for axis, side in zip(tensor.type.tensor_type.shape.dim[1:3], SIZE, strict=True):
            axis.dim_value = side
    return model


@pytest.fixture(scope="session")
def exported(lite_checkpoint, beside, fixed_graph, tmp_path_factory):
    """The report of an export."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exporter, "trace", lambda *_, **__: copy.deepcopy(fixed_graph))
        return export_checkpoint(
            lite_checkpoint,
            tmp_path_factory.mktemp("exported") / "lite.onnx",
            size=SIZE,
            record_dir=beside / "recording",
            triton_dir=beside / "repository",
        )


@pytest.fixture
def traced(exported, dynamic_model, monkeypatch):
    """Exports of `lite_checkpoint` at SIZE take graph and work of `exported`: both take seconds."""

    def trace(*_, dynamic, **__):
        return copy.deepcopy(dynamic_model) if dynamic else onnx.load(exported.path)

    monkeypatch.setattr(exporter, "trace", trace)
    monkeypatch.setattr(exporter, "count_giga_macs", lambda *_: exported.contract.giga_macs)


@pytest.fixture(scope="session")
def small_model():
    """Builds a small member of the named variant."""
    return build_small
