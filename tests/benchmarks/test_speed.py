"""The comparison of networks: what a name stands for, and a run from the command line."""

import json
import sys

import pytest

import speed
from runtime.errors import InputError, SSDNetError


def test_a_name_is_a_bundled_file_before_a_network_of_random_weights(monkeypatch):
    exported = []
    monkeypatch.setattr(speed, "export_random", lambda name: exported.append(name) or b"random")
    bundled = speed.load_network("ssdnet-lite")
    assert len(bundled) > 1e6
    assert exported == []
    assert speed.load_network("random:ssdnet-lite") == b"random"
    assert speed.load_network("fast-scnn") == b"random"
    assert exported == ["ssdnet-lite", "fast-scnn"]
    assert speed.load_network("ip-basic").contract.model_name == "ip-basic"


def test_an_unknown_name_lists_all_that_are_known():
    with pytest.raises(InputError, match=r"called 'mobilenet'; there are: .*ssdnet-lite.*pidnet-s"):
        speed.load_network("mobilenet")
    with pytest.raises(SSDNetError, match=r"no\.onnx"):
        speed.load_network("no.onnx")
    with pytest.raises(SSDNetError, match=r"no\.pt"):
        speed.load_network("no.pt")


def test_a_run_writes_a_table_a_size_and_leaves_out_what_does_not_fit(
    monkeypatch, tmp_path, capsys, small_model
):
    files = {"free": small_model(), "fixed": small_model(64, 96)}
    monkeypatch.setattr(speed, "load_network", files.__getitem__)
    options = ["--sizes", "32x48", "64x96", "--threads", "1", "--rounds", "2"]
    written = ["--markdown", tmp_path / "t.md", "--json", tmp_path / "t.json"]
    monkeypatch.setattr(sys, "argv", ["speed.py", *files, *options, *map(str, written)])
    speed.main()
    document = json.loads((tmp_path / "t.json").read_text())
    names = [[row["network"] for row in part["rows"]] for part in document["sizes"]]
    assert [part["size"] for part in document["sizes"]] == [[32, 48], [64, 96]]
    assert names == [["free"], ["free", "fixed"]]
    assert document["reference"] == "free"
    assert document["machine"]["threads"] == 1
    text = (tmp_path / "t.md").read_text()
    assert text in capsys.readouterr().out
    assert "**64 x 96**" in text
    assert "| fixed |" in text
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--reference", "fixed"])
    with pytest.raises(SystemExit, match="fixed is of fixed size: it does not take 32x48"):
        speed.main()
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--reference", "other"])
    with pytest.raises(SystemExit):
        speed.main()
    assert "--reference other: is none of the networks: free, fixed" in capsys.readouterr().err
