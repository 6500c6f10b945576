"""Networks with random weights as files: which graph a name means."""

import sys

from onnxruntime import InferenceSession

import random_weights
from export.deploy import DeployGraph
from random_weights import LogitsGraph


def test_each_name_is_a_file(monkeypatch, tmp_path, model_file, capsys):
    graphs, model = [], model_file(contract=None).read_bytes()
    monkeypatch.setattr(random_weights, "export_graph", lambda graph: graphs.append(graph) or model)
    names = ["ssdnet-nano", "sparse-conv", "fast-scnn"]
    monkeypatch.setattr(sys, "argv", ["random_weights.py", str(tmp_path / "new"), *names])
    random_weights.main()
    assert [graph.model.config.name for graph in graphs] == names
    assert [type(graph) for graph in graphs] == [DeployGraph, DeployGraph, LogitsGraph]
    assert "ssdnet-nano: 1.1 M parameters, 1.96 GMACs\n" in capsys.readouterr().out
    for name in names:
        InferenceSession(str(tmp_path / "new" / f"{name}.onnx"))
