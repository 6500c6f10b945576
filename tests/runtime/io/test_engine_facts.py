"""What reports state about the engine is what the predictor runs."""

import json
from dataclasses import asdict

import pytest

import runtime
from runtime import Predictor
from runtime.io import engine_facts as facts_module
from runtime.io.engine_facts import engine_facts, machine_facts


def test_the_facts_are_those_of_the_predictor(model_file, contract):
    with Predictor(model_file(), size=40, threads=1, warmup=1) as predictor:
        facts = engine_facts(predictor)
        assert facts.ssdnet == runtime.__version__
        assert facts.model.name == contract.model_name
        assert facts.model.sha256 == predictor.digest
        assert facts.model.size_asked == 40
        assert facts.model.heads == predictor.heads
        assert (facts.provider.asked, facts.provider.threads) == ("cpu", 1)
        assert facts.provider.running == ("CPUExecutionProvider",)
        assert facts.machine.cpu
        assert facts.first_inference_ms > 0
    document = json.loads(json.dumps(asdict(facts)))
    assert document.keys() == {
        *("ssdnet", "model", "provider", "machine", "load_ms", "first_inference_ms")
    }


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        ("fpu sse2 avx avx2 fma", "AVX2"),
        ("avx2 avx512f avx512_vnni amx_tile amx_int8", "AVX2, AVX-512, VNNI, AMX"),
        ("avx2 avx_vnni", "AVX2, VNNI"),
        ("fpu sse2", "no AVX2 reported"),
    ],
)
def test_the_processor_is_named_with_its_instruction_sets(tmp_path, monkeypatch, flags, named):
    info = tmp_path / "cpuinfo"
    info.write_text(
        f"processor\t: 0\nmodel name\t: Fast One\nflags\t\t: {flags}\n\nflags\t: amx_tile"
    )
    monkeypatch.setattr(facts_module, "_CPU_INFO", info)
    assert machine_facts().processor == f"Fast One ({named})"


def test_a_system_without_cpuinfo_has_a_processor(tmp_path, monkeypatch):
    monkeypatch.setattr(facts_module, "_CPU_INFO", tmp_path / "none")
    assert machine_facts().processor.endswith(" (no AVX2 reported)")
