"""Options of ssdnet-run: the model and how it runs, help, and values that are refused."""

import dataclasses
import json
import re

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from cli_runs import files_in, rows_of
from runtime.app.run.cli import app
from runtime.app.run.options import KINDS, RunOptions


@pytest.mark.parametrize(("size", "runs_at"), [("auto", (40, 53)), ("33x70", (33, 70))])
def test_the_size_at_which_the_network_ran_is_reported(
    tmp_path, run, stream, make_frame, model_file, contract, size, runs_at
):
    rgb, depth = make_frame(52, 69)
    cv2.imwrite(str(stream[0] / "f0.png"), rgb[..., ::-1])
    cv2.imwrite(str(stream[1] / "f0.png"), np.rint(depth * 256).astype(np.uint16))
    model = model_file(contract=dataclasses.replace(contract, trained_height=40))
    result = run("--model", model, "--size", size, "--limit", 1)
    assert result.exit_code == 0, result.output
    at = "{} x {}".format(*runs_at)
    assert f"frames 52 x 69, network at {at}\n" in result.stdout
    (row,) = rows_of(tmp_path / "out")
    assert (row["height"], row["width"]) == ("52", "69")
    assert (int(row["network_height"]), int(row["network_width"])) == runs_at
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["frames"]["by_network_size"] == {at: 1}
    assert report["model"]["trained_height"] == 40
    assert cv2.imread(str(tmp_path / "out/semantic/f0.png"), -1).shape == (52, 69)


def test_the_model_is_the_one_that_was_asked_for(tmp_path, run):
    few = ["--limit", 1, "--overwrite"]
    assert run(*few).exit_code == 0
    digest = json.loads((tmp_path / "out/report.json").read_text())["model"]["sha256"]
    before = files_in(tmp_path / "out")
    (tmp_path / "bad.onnx").write_bytes(b"no model")
    for wrong, text in (
        (["--sha256", "0" * 64], digest),
        (["--model", "ssdnet-huge"], "no bundled model is called 'ssdnet-huge'; there are: "),
        (["--model", tmp_path / "bad.onnx"], "cannot be loaded"),
    ):
        result = run(*wrong, *few)
        assert result.exit_code == 1
        assert text in result.stderr
    assert files_in(tmp_path / "out") == before, "an earlier run is left alone"
    assert run("--sha256", digest, *few).exit_code == 0
    assert run("--model", "ssdnet-nano", *few).exit_code == 0
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["model"]["path"].endswith("assets/ssdnet-nano.onnx")


@pytest.mark.parametrize(("given", "said"), [
    ("", "give one of PATH, --demo, --rgb"),
    ("--demo --depth somewhere", "give one of PATH, --demo, --rgb (with --depth or --points)"),
    ("somewhere --rgb somewhere", "give one of PATH, --demo, --rgb"),
    ("--demo --save depth,none", "--save is none, or some of all, semantic, depth"),
    ("--demo --save all,clouds", "--save is none, or some of all, semantic, depth"),
    ("--rgb images --depth depth --rectify", "--rectify goes with --points"),
    ("--demo --overlay-width 1", "'--overlay-width': "),
    ("--demo --size large", "size 'large': neither a keyword nor a number of pixels; expected"),
    ("--source folders:somewhere,depth_scale=0", "depth_scale must be units per metre, 0.001 to"),
    ("--demo --provider gpu", "'gpu' is not one of 'cpu', 'cuda'"),
    ("--demo --video out.avi", "--video writes .mp4 files, got out.avi"),
    ("--demo --shard 0/4", "--shard is I/N with 1 <= I <= N, such as 2/4, got '0/4'"),
    ("--demo --shard 5/4", "--shard is I/N"),
    ("--demo --shard 1/4 --memory 2", "--memory needs the frames in order"),
    ("--demo --shard 1/\N{SUPERSCRIPT TWO}", "--shard is I/N"),
    ("--demo --record a/b --out a", "a/b needs a folder apart from other results"),
    ("--demo --record a --out a/b", "a needs a folder apart"),
    ("--demo --record a --video a/b.mp4", "a needs a folder apart"),
])  # fmt: skip
def test_wrong_usage_is_exit_code_2_and_names_the_option(given, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, given.split())
    assert (result.exit_code, list(tmp_path.iterdir())) == (2, [])
    assert said in " ".join(result.output.split())


@pytest.mark.parametrize(("texts", "kinds"), [
    (["all,cloud"], {*KINDS, "cloud"}), (["cloud", "all"], {*KINDS, "cloud"}),
    (["all"], set(KINDS)), (["none"], set()), (["depth", "cloud"], {"depth", "cloud"}),
    (None, set(KINDS)),
])  # fmt: skip
def test_all_adds_to_other_kinds(texts, kinds):
    assert set(RunOptions(demo=True, save=texts).kinds) == kinds


def test_the_focal_length_reaches_the_model(tmp_path, run, model_file, contract):
    """The graph adds 1.5 canonical metres: 3 m behind a lens twice as long."""
    path = model_file("c.onnx", contract=dataclasses.replace(contract, canonical_focal_px=100.0))
    result = run("--model", path, "--focal-length", 200, "--limit", 1)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    expected = {"focal_length_px": 200.0, "used_focal_length_px": 200.0, "depth_range_m": 160.0}
    assert expected.items() <= report["inputs"].items()
    assert report["model"]["canonical_focal_px"] == 100.0
    assert "focal length 200 px; depth up to 160 m\n" in result.stdout
    picture = cv2.imread(str(tmp_path / "out/depth/f0.png"), cv2.IMREAD_UNCHANGED)
    assert picture.min() == 3 * 256
    not_known = run("--model", path, "--limit", 1, "--overwrite").stdout
    assert "\nfocal length not known: give --focal-length; depth up to 80 m\n" in not_known
    unused = run("--focal-length", 200, "--limit", 1, "--overwrite").stdout
    assert "\nfocal length 200 px, not used by this model; depth up to 80 m\n" in unused


def test_help_groups_the_options():
    result = CliRunner().invoke(app, ["--help"])
    lines = result.stdout.splitlines()
    titles = [line for line in lines if re.fullmatch(r"[A-Z][a-z ]+:", line)]
    assert titles == ["Input:", "Outputs:", "Model:", "Timing:", "Other:"]
    for option, title in (("--rgb", "Input:"), ("--video", "Outputs:"), ("--rate", "Timing:")):
        (at,) = (number for number, line in enumerate(lines) if line.startswith(f"  {option} "))
        assert [line for line in lines[:at] if line in titles][-1] == title
    assert "Exit codes" in result.stdout
