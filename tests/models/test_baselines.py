"""Other people's networks: their size and work as they are known, and their exported files."""

import pytest
import torch
from torch.nn import functional as F
from torch.utils.flop_counter import FlopCounterMode

from export.exporter import export_checkpoint
from export.probe_frames import probe_frames
from models import create_model, save_checkpoint
from models.blocks import adaptive_mean

#: Parameters and multiply-accumulates at 128 x 416 with 19 classes.
KNOWN = {"ddrnet-23-slim": (5.70e6, 0.92e9), "fast-scnn": (1.14e6, 0.17e9)}


@pytest.mark.parametrize("name", KNOWN)
def test_params_and_macs_are_the_known_ones(name):
    with torch.device("meta"):
        model = create_model(name, num_classes=19).eval()
        frame = torch.empty(1, 3, 128, 416), torch.empty(1, 1, 128, 416)
        with FlopCounterMode(display=False) as counter:
            model(*frame)
    params, macs = KNOWN[name]
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(params, rel=0.005)
    assert counter.get_total_flops() / 2 == pytest.approx(macs, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("dynamic", [False, True])
def test_exports_at_any_size_with_19_classes(name, dynamic, tmp_path):
    torch.manual_seed(0)
    model = create_model(name, num_classes=19).train()
    frames = probe_frames((128, 192), max_depth_m=100.0, seeds=(5, 6, 7))[:3]
    rgb = torch.stack([torch.from_numpy(f.rgb).permute(2, 0, 1).float() for f in frames])
    with torch.no_grad():
        for _ in range(5):  # batch statistics of pictures, so that answers vary
            model(rgb, torch.zeros(3, 1, 128, 192))
    save_checkpoint(tmp_path / "c.pt", model)
    size = (97, 142) if dynamic else (128, 192)
    report = export_checkpoint(
        tmp_path / "c.pt", tmp_path / "m.onnx", size=size, dynamic=dynamic, with_logits=True
    )
    assert report.heads == ("semantic", "semantic_logits")
    assert all(head.passed for head in report.parity.values())  # odd and smallest sizes too


@pytest.mark.parametrize("size", [(4, 13), (1, 1), (7, 5)])
@pytest.mark.parametrize("cells", [1, 2, 3, 6])
def test_adaptive_mean_is_adaptive_average_pooling(size, cells):
    x = torch.randn(2, 3, *size, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(adaptive_mean(x, cells), F.adaptive_avg_pool2d(x, cells))
