"""ssdnet-info tells what the file says, in lines and in JSON, and refuses what is no model."""

import dataclasses
import json

import pytest
from typer.testing import CliRunner

from runtime import list_bundled_models
from runtime.tools.info import app


def run(*arguments):
    return CliRunner().invoke(app, list(arguments))


def test_without_a_model_the_bundled_ones_are_listed():
    models = list_bundled_models()
    _, *lines = run().output.splitlines()
    assert [line.split()[0] for line in lines[: len(models)]] == models
    assert json.loads(run("--json").output) == {"bundled_models": list_bundled_models()}


def test_the_lines_hold_what_the_metadata_and_the_tensors_say(model_file, contract):
    contract = dataclasses.replace(
        contract,
        canonical_focal_px=721.5,
        trained_height=400,
        training={"data": ["one", "two"], "terms": "research only"},
        parity={"depth": {"max_abs_m": 0.00012345}},
        giga_macs=2.125,
        accuracy={"repeat": "ssdnet-eval MODEL", "rows": [{"miou": 0.5}, {"miou": None}]},
    )
    path = model_file(size=(48, 64), contract=contract)
    lines = run(str(path)).output.splitlines()
    shown = {line[:24].strip(): line[24:].strip() for line in lines}
    assert shown["model"] == "by-hand"
    assert shown["heads"] == "semantic, depth, boundary"
    assert shown["fixed size"] == "48 x 64"
    assert shown["trained for"] == "400 rows"
    assert shown["frames a run"] == "any number"
    assert shown["canonical focal length"] == "721.5 px"
    assert shown["GMACs a frame"] == "2.12"
    assert shown["repeat"] == "ssdnet-eval MODEL"
    assert [line.split()[-1] for line in lines if line.startswith("  rows")] == ["0.5", "None"]
    assert shown["terms"] == "research only"
    assert shown["trained on"] == "one, two"
    assert shown["depth"] == "max_abs_m 0.00012345"
    assert shown["classes"] == "2"
    assert shown["0"] == "dark #000080"
    assert shown["1"] == "red #c81e1e"
    assert shown["schema"] == contract.schema_version


def test_the_json_holds_the_contract_and_the_digest(model_file, contract):
    document = json.loads(run(str(model_file()), "--json").output)
    assert document["fixed_size"] is None
    assert len(document["sha256"]) == 64
    metadata = document["metadata"]
    assert metadata["max_depth_m"] == contract.max_depth_m
    assert [entry["name"] for entry in metadata["classes"]] == ["dark", "red"]


def test_a_batch_of_one_is_reported(model_file):
    def only_one(graph):
        for tensor in graph.input:
            tensor.type.tensor_type.shape.dim[0].dim_value = 1

    path = model_file(edit=only_one)
    assert "frames a run            one" in run(str(path)).output.splitlines()


def test_a_files_text_does_not_steer_the_terminal(model_file, contract):
    contract = dataclasses.replace(contract, training={"terms": "none\x1b[2J\nmodel   other"})
    lines = run(str(model_file(contract=contract))).output.splitlines()
    assert r"terms                   none\x1b[2J\nmodel   other" in lines


@pytest.mark.parametrize("name", ["ssdnet-huge", "./nothing.onnx"])
def test_what_is_no_model_is_an_error(name):
    result = run(name)
    assert result.exit_code == 1
    assert result.output.startswith("error: ")
