"""Networks with random weights as files: which graph a name means."""

import sys

import torch
from onnxruntime import InferenceSession

import random_weights
from export.deploy import DeployGraph
from models import create_model
from random_weights import LogitsGraph


def test_each_name_is_a_file(monkeypatch, tmp_path, small_model, capsys):
    graphs = []
    monkeypatch.setattr(
        random_weights, "export_graph", lambda graph: graphs.append(graph) or small_model()
    )
    names = ["ssdnet-nano", "sparse-conv", "fast-scnn"]
    monkeypatch.setattr(sys, "argv", ["random_weights.py", str(tmp_path / "new"), *names])
    random_weights.main()
    assert [graph.model.config.name for graph in graphs] == names
    assert [type(graph) for graph in graphs] == [DeployGraph, DeployGraph, LogitsGraph]
    assert "ssdnet-nano: 1.09 M parameters, 1.74 GMACs\n" in capsys.readouterr().out
    for name in names:
        InferenceSession(str(tmp_path / "new" / f"{name}.onnx"))


def test_logits_of_others_are_those_of_the_network_at_full_size():
    network = create_model("fast-scnn", num_classes=19).eval()
    rgb = torch.randint(0, 256, (1, 50, 70, 3), dtype=torch.uint8)
    with torch.no_grad():
        (logits,) = LogitsGraph(network)(rgb, torch.zeros(1, 50, 70))
        expected = network(rgb.permute(0, 3, 1, 2).float(), torch.zeros(1, 1, 50, 70))
    assert logits.shape == (1, 19, 50, 70)
    torch.testing.assert_close(logits, expected.semantic_logits)
