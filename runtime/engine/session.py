"""Opens ONNX Runtime sessions on the requested provider, or raises an error."""

import contextlib
import io
import os
import re
from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from runtime.base.arguments import shown
from runtime.base.errors import ContractError, ProviderError, import_remedy, install_command

PROVIDERS: Mapping[str, str] = MappingProxyType(
    {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}
)
_GPU_NEEDS = (
    f"it needs an NVIDIA driver and: pip uninstall -y onnxruntime; {install_command('gpu')}"
)
_NO_MEMORY = re.compile("allocate|bad_alloc|out of memory", re.IGNORECASE)
# If one of these runs on another provider, the requested provider does not do the work.
_HEAVY_OPERATORS = frozenset({"Conv", "FusedConv", "QLinearConv", "ConvInteger", "NhwcConv"})


def import_onnxruntime() -> Any:
    """Return the module `onnxruntime`; ProviderError if it is missing or broken."""
    try:
        import onnxruntime
    except ImportError as error:
        raise ProviderError(
            f"no ONNX Runtime ({error}): {import_remedy(error, 'cpu')} (for an NVIDIA GPU use the "
            "extra gpu instead of cpu; both cannot be installed together)"
        ) from error
    return onnxruntime


def open_session(
    model: bytes,
    *,
    provider: str = "cpu",
    device_id: int = 0,
    threads: int,
    weights_folder: str = os.devnull,
) -> Any:
    """Open a session.

    Args:
        model: the bytes of an ONNX file.
        provider: "cpu" or "cuda".
        device_id: index of the GPU.
        threads: number of threads within an operator.
        weights_folder: folder of weights that a foreign network keeps outside its ONNX file. The
            default is an invalid folder, so that loading such a network fails.

    Raises:
        ProviderError: if the provider cannot be used.
        ContractError: if the model cannot be loaded.
    """
    if not isinstance(provider, str) or provider not in PROVIDERS:
        raise ProviderError(
            f"unknown provider {shown(provider)}: expected one of {sorted(PROVIDERS)}"
        )
    ort = import_onnxruntime()
    name, available = PROVIDERS[provider], ort.get_available_providers()
    if name not in available:
        needs = _GPU_NEEDS if provider == "cuda" else install_command("cpu")
        raise ProviderError(
            f"provider {provider!r} is not part of the installed ONNX Runtime {ort.__version__} "
            f"(it has {', '.join(available)}): {needs}"
        )
    printed, settings = "", {}
    if provider == "cuda":
        # An exhaustive algorithm search would delay the first frame of every new size.
        settings = {"device_id": str(device_id), "cudnn_conv_algo_search": "HEURISTIC"}
        printed = _preload(ort)
    try:
        options, providers = _options(ort, threads, weights_folder), [(name, settings)]
        session = ort.InferenceSession(
            model, sess_options=options, providers=providers, enable_fallback=False
        )
    except Exception as error:
        if provider == "cpu":
            raise _unloadable(error) from error
        # If the file is damaged, opening it on the CPU raises the right error.
        open_session(model, threads=threads, weights_folder=weights_folder)
        raise ProviderError(
            f"provider {provider!r} could not be started ({error}) {printed}: {_GPU_NEEDS}"
        ) from error
    _require_running(session, provider, printed)
    return session


def describe_error(error: Exception) -> str:
    """Return the text of an error of ONNX Runtime or NumPy, with a remedy if memory ran out."""
    if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
        return f"out of memory, choose a smaller size or fewer frames ({error})"
    return str(error)


def node_counts(session: Any) -> dict[str, int]:
    """Return execution provider -> number of graph nodes."""
    return dict(Counter(provider for provider, _ in _assigned_nodes(session)))


def _options(ort: Any, threads: int, weights_folder: str) -> Any:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 4  # errors are exceptions
    add = options.add_session_config_entry
    # A spinning thread occupies a core between the frames of a stream, and is no faster.
    add("session.intra_op.allow_spinning", "0")
    add("session.inter_op.allow_spinning", "0")
    add("session.record_ep_graph_assignment_info", "1")
    add("session.model_external_initializers_file_folder_path", weights_folder)
    return options


def _preload(ort: Any) -> str:
    """Load CUDA and cuDNN from their pip packages; return the printed text."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(Exception):
        ort.preload_dlls()
    return " ".join(printed.getvalue().split())


def _require_running(session: Any, provider: str, printed: str) -> None:
    """Raise ProviderError if ONNX Runtime fell back to the CPU, which is only a warning there.

    Shape arithmetic of a model of free size belongs on the CPU (`session.disable_cpu_ep_fallback`
    would refuse it); a convolution does not.
    """
    name, running = PROVIDERS[provider], session.get_providers()
    strays = {
        f"{operator} on {where}"
        for where, operator in _assigned_nodes(session)
        if where != name and operator in _HEAVY_OPERATORS
    }
    if name not in running or strays:
        found = ", ".join(sorted(strays) if name in running else running)
        raise ProviderError(
            f"provider {provider!r} was requested, but ONNX Runtime would run {found} {printed}: "
            f"{_GPU_NEEDS}; if it runs other models, export this one again"
        )


def _assigned_nodes(session: Any) -> list[tuple[str, str]]:
    """Return (execution provider, operator) of every node."""
    subgraphs = session.get_provider_graph_assignment_info()
    return [(each.ep_name, node.op_type) for each in subgraphs for node in each.get_nodes()]


def _unloadable(error: Exception) -> ContractError:
    """Return the error for a file that ONNX Runtime refuses."""
    text = describe_error(error)
    if "external data" in text.lower():
        unreadable = "" if os.devnull in text else f", which cannot be read ({text})"
        return ContractError(
            f"the model keeps weights outside its own file{unreadable}: save it as one file, with "
            "onnx.save or torch.onnx.export(..., external_data=False)"
        )
    if "IR version" in text or "opset" in text.lower():
        fault = "it uses a newer ONNX version than this ONNX Runtime supports; update onnxruntime"
    elif "protobuf" in text.lower():
        fault = "the file is truncated or damaged; get it again"
    else:
        fault = "export it again, or update onnxruntime"
    return ContractError(f"the model cannot be loaded ({text}): {fault}")
