"""Small members of every variant of the family, for tests that trace or run them."""

import copy
from dataclasses import replace
from functools import partial

import pytest
import torch

from export import build, exporter
from export.deploy import DeployGraph
from export.exporter import export_checkpoint
from export.probe_frames import probe_frames
from export.trace import trace
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


@pytest.fixture(
    scope="session", params=["ssdnet", pytest.param("ssdnet-lite", marks=pytest.mark.slow)]
)
def dynamic_network(request):
    """The network of `dynamic_model`; to trace ssdnet-lite for any size takes a minute."""
    return build_small(request.param)


@pytest.fixture(scope="session")
def dynamic_model(dynamic_network):
    """The graph of any size, with logits."""
    return trace(DeployGraph(dynamic_network, with_logits=True), size=SIZE, dynamic=True)


@pytest.fixture(scope="session")
def lite_model(lite):
    """The graph of ssdnet-lite for frames of SIZE."""
    return trace(DeployGraph(lite), size=SIZE)


@pytest.fixture(scope="session")
def exported(lite_checkpoint, beside, lite_model, tmp_path_factory):
    """The report of an export."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "trace", lambda *_, **__: copy.deepcopy(lite_model))
        return export_checkpoint(
            lite_checkpoint,
            tmp_path_factory.mktemp("exported") / "lite.onnx",
            size=SIZE,
            record_dir=beside / "recording",
            triton_dir=beside / "repository",
        )


@pytest.fixture
def one_frame(monkeypatch):
    """Exports are verified with one frame of the native size; `exported` with all frames."""
    frames = partial(probe_frames, max_depth_m=100.0)
    monkeypatch.setattr(exporter, "frames_of", lambda size, **_: frames(size)[:1])


@pytest.fixture
def traced(exported, lite_model, one_frame, monkeypatch):
    """Exports of `lite_checkpoint` at SIZE take graph and work of `exported`: both take seconds."""
    monkeypatch.setattr(build, "trace", lambda *_, **__: copy.deepcopy(lite_model))
    monkeypatch.setattr(build, "count_giga_macs", lambda *_: exported.contract.giga_macs)


@pytest.fixture
def traced_for_any_size(dynamic_network, dynamic_model, one_frame, tmp_path, monkeypatch):
    """The checkpoint of `dynamic_network`, of which exports take the graph `dynamic_model`."""
    monkeypatch.setattr(build, "trace", lambda *_, **__: copy.deepcopy(dynamic_model))
    path = tmp_path / "any-size.pt"
    save_checkpoint(path, dynamic_network)
    return path


@pytest.fixture(scope="session")
def small_model():
    """Builds a small member of the named variant."""
    return build_small
