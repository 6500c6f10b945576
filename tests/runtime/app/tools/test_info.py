"""ssdnet-info prints what the file says, and refuses what is no model."""

import dataclasses

import pytest
from typer.testing import CliRunner

from runtime import list_bundled_models
from runtime.app.tools.info import app


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_without_a_model_the_bundled_ones_are_listed():
    models = list_bundled_models()
    _, *lines = run().output.splitlines()
    assert [line.split()[0] for line in lines[: len(models)]] == models


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
