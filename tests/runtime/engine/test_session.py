"""The requested provider is used, or an error says what is missing: with a stand-in runtime."""

import builtins
import sys
from types import SimpleNamespace

import pytest

from runtime import ContractError, Predictor, ProviderError
from runtime.base.errors import install_command
from runtime.engine.session import node_counts, open_session

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"


def fake_session(running, nodes):
    """A session that runs `running`, with nodes of (provider, operator)."""
    assigned = [
        SimpleNamespace(ep_name=name, get_nodes=lambda op=op: [SimpleNamespace(op_type=op)])
        for name, op in nodes
    ]
    return SimpleNamespace(
        get_providers=lambda: running, get_provider_graph_assignment_info=lambda: assigned
    )


@pytest.fixture
def fake_runtime(monkeypatch):
    """Install a stand-in for onnxruntime; `answers` maps a provider to a session or an error."""

    def install(answers, available=(CUDA, CPU)):
        calls = []

        def make_session(model, *, sess_options, providers, enable_fallback):
            assert not enable_fallback
            calls.append((providers[0], sess_options))
            answer = answers[providers[0][0]]
            if isinstance(answer, Exception):
                raise answer
            return answer

        def preload_dlls():
            sys.stdout.write("Failed to load libcudnn.so.9\n")

        module = SimpleNamespace(
            __version__="9.9",
            InferenceSession=make_session,
            SessionOptions=lambda: SimpleNamespace(add_session_config_entry=lambda *entry: None),
            ExecutionMode=SimpleNamespace(ORT_SEQUENTIAL=0),
            GraphOptimizationLevel=SimpleNamespace(ORT_ENABLE_ALL=99),
            get_available_providers=lambda: list(available),
            preload_dlls=preload_dlls,
        )
        monkeypatch.setitem(sys.modules, "onnxruntime", module)
        return calls

    return install


def open_cuda():
    return open_session(b"model", provider="cuda", device_id=1, threads=2)


def test_without_onnxruntime_the_two_commands_are_named(monkeypatch, model_file):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ProviderError) as error:
        Predictor(model_file())
    assert install_command("cpu") in str(error.value)
    assert "gpu instead of cpu" in str(error.value)


def test_an_onnxruntime_that_cannot_be_loaded_is_not_called_missing(monkeypatch):
    def broken(name, *arguments, **options):
        raise ImportError("libcudart.so.13: cannot open shared object file")

    monkeypatch.delitem(sys.modules, "onnxruntime", raising=False)
    monkeypatch.setattr(builtins, "__import__", broken)
    with pytest.raises(ProviderError, match=r"libcudart.*ssdnet-doctor"):
        open_cuda()


def test_cuda_that_this_onnxruntime_does_not_have(fake_runtime):
    fake_runtime({}, available=(CPU,))
    with pytest.raises(ProviderError, match=r"it has CPUExecutionProvider.*gpu"):
        open_cuda()


@pytest.mark.parametrize("name", ["gpu", "CUDA"])
def test_a_provider_of_another_name(model_file, name):
    with pytest.raises(ProviderError, match=r"expected one of \['cpu', 'cuda'\]"):
        Predictor(model_file(), provider=name)


def test_cuda_that_runs(fake_runtime):
    nodes = [(CUDA, "Conv"), (CUDA, "Relu"), (CPU, "Gather")]
    calls = fake_runtime({CUDA: fake_session([CUDA, CPU], nodes)})
    session = open_cuda()
    assert node_counts(session) == {CUDA: 2, CPU: 1}
    ((name, provider_options), options) = calls[0]
    assert name == CUDA
    assert provider_options == {"device_id": "1", "cudnn_conv_algo_search": "HEURISTIC"}
    assert options.intra_op_num_threads == 2


def test_threads_do_not_spin_between_frames(model_file):
    options = open_session(model_file().read_bytes(), threads=2).get_session_options()
    for threads in ("intra_op", "inter_op"):
        assert options.get_session_config_entry(f"session.{threads}.allow_spinning") == "0"


@pytest.mark.parametrize(("cuda", "cpu", "error", "text"), [
    # A silent fall-back.
    (fake_session([CPU], [(CPU, "Conv")]), None, ProviderError, "CPUExecutionProvider.*libcudnn"),
    (fake_session([CUDA, CPU], [(CPU, "Conv")]), None, ProviderError, "Conv on CPUExecution"),
    (RuntimeError("no CUDA device"), fake_session([CPU], []), ProviderError, "no CUDA device"),
    # A damaged model is not blamed on the GPU.
    (*[RuntimeError("Protobuf parsing failed")] * 2, ContractError, "Protobuf parsing failed"),
], ids=["only the CPU", "a convolution on the CPU", "no GPU", "a damaged model"])  # fmt: skip
def test_cuda_that_cannot_run_the_model(fake_runtime, capsys, cuda, cpu, error, text):
    fake_runtime({CUDA: cuda, CPU: cpu})
    with pytest.raises(error, match=text):
        open_cuda()
    assert capsys.readouterr().out == "", "the library printed"
