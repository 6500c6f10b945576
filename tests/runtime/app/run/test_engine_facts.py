"""What reports state about the engine is what the predictor runs."""

import json

import numpy as np

import runtime
from runtime import Predictor
from runtime.app.run.engine_facts import engine_facts
from runtime.command.machine import MachineFacts


def test_the_facts_are_those_of_the_predictor(model_file, contract):
    with Predictor(model_file(), size=40, threads=1, warmup=1) as predictor:
        facts = engine_facts(predictor)
        assert facts["ssdnet"] == runtime.__version__
        model, provider = facts["model"], facts["provider"]
        assert (model["name"], model["sha256"]) == (contract.model_name, predictor.model.sha256)
        assert (model["size_asked"], model["heads"]) == (40, predictor.heads)
        assert (provider["asked"], provider["threads"]) == ("cpu", 1)
        assert facts["first_inference_ms"] > 0
    machine = {**facts["machine"], "cpu": "Fast One", "instruction_sets": ("AVX2", "VNNI")}
    assert MachineFacts(**machine).processor == "Fast One (AVX2, VNNI)"
    assert facts["libraries"]["numpy"] == np.__version__
    names = {"ssdnet", "model", "provider", "machine", "libraries", "load_ms", "first_inference_ms"}
    assert json.loads(json.dumps(facts)).keys() == names
