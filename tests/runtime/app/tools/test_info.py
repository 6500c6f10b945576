"""ssdnet-info prints what the file says, and refuses what is no model."""

import dataclasses
from pathlib import Path

import pytest
from typer.testing import CliRunner

from runtime import list_bundled_models
from runtime.app.tools.info import app
from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import find_model


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_bundled_models_are_listed():
    """The list has their size, work and accuracy, and what these were measured on."""
    result = run()
    assert result.exit_code == 0
    heading, *lines = result.stdout.splitlines()
    assert heading.split() == ["model", "MB", "GMACs", "mIoU", "%", "MAE", "mm"]
    models = list_bundled_models()
    rows = {name: [float(cell) for cell in cells] for name, *cells in map(str.split, lines[:6])}
    assert list(rows) == models
    for name, row in rows.items():
        file = load_model_file(find_model(name))
        measured = file.contract.accuracy["rows"]
        miou = next(each["miou"] for each in measured if each["miou"])
        mae_m = next(each["mae_m"] for each in measured if each["mae_m"])
        expected = [len(file.content) / 1e6, file.contract.giga_macs, 100 * miou, 1000 * mae_m]
        assert row == [pytest.approx(value, abs=0.51 if value > 99 else 0.06) for value in expected]
    assert (rows["ssdnet-lite"][1], rows["ssdnet-nano"][1]) == (4.3, 2.0)
    others = ", ".join(models[:-1])
    assert lines[6:11] == [
        "GMACs of a frame of 512 x 1024",
        f"mIoU % on camvid split=val, LiDAR none: {others}",
        f"MAE mm on kitti_streets first=70 last=98, LiDAR own: {others}",
        # The limits of its 8-bit file are kept without data that are not its own.
        "mIoU % on open_gate scans=True, LiDAR own: ssdnet-open-int8",
        "MAE mm on open_gate scans=True, LiDAR own: ssdnet-open-int8",
    ]
    assert Path(lines[11].partition(": ")[2]).is_file()


def test_the_lines_hold_what_the_metadata_and_the_tensors_say(model_file, contract):
    def only_one(graph):
        for tensor in graph.input:
            tensor.type.tensor_type.shape.dim[0].dim_value = 1

    contract = dataclasses.replace(
        contract,
        canonical_focal_px=721.5,
        training={"data": ["one", "two"], "terms": "none\x1b[2J\nmodel name   other"},
        parity={"depth": {"max_abs_m": 0.00012345}},
        accuracy={"repeat": "ssdnet-eval MODEL", "rows": [{"miou": 0.5}, {"miou": None}]},
    )
    lines = run(model_file(size=(48, 64), contract=contract, edit=only_one)).output.splitlines()
    shown = {line[:24].strip(): line[24:] for line in lines}
    expected = {
        "model name": "by-hand",
        "heads": '["semantic", "depth", "boundary"]',
        "fixed size": "[48, 64]",
        "frames a run": "one",
        "canonical focal px": "721.5",
        "trained height": "null",
        "data": '["one", "two"]',
        "terms": r"none\x1b[2J model name other",  # a file does not steer the terminal
        "depth": '{"max_abs_m": 0.00012345}',
        "repeat": "ssdnet-eval MODEL",
        "0": "dark #000080",
        "1": "red #c81e1e",
    }
    assert {name: shown[name] for name in expected} == expected
    rows = [line[24:] for line in lines if line.startswith("  rows")]
    assert rows == ['{"miou": 0.5}', '{"miou": null}']
    assert len(shown["sha256"]) == 64


@pytest.mark.parametrize("name", ["ssdnet-huge", "./nothing.onnx"])
def test_what_is_no_model_is_an_error(name):
    result = run(name)
    assert result.exit_code == 1
    assert result.output.startswith("error: ")
