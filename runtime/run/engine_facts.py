"""What a report states about the model, the provider that runs it, and the machine."""

import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import runtime
from runtime.network_size import NetworkSize

if TYPE_CHECKING:
    from runtime.predictor import Predictor

_CPU_INFO = Path("/proc/cpuinfo")
#: Instruction sets that decide how fast a network runs -> Linux' flags, of which any counts.
_SETS = {
    "AVX2": {"avx2"},
    "AVX-512": {"avx512f"},
    "VNNI": {"avx_vnni", "avx512_vnni"},
    "AMX": {"amx_tile"},
}


@dataclass(frozen=True)
class ModelFacts:
    """The model file, and how the predictor runs it.

    Attributes:
        name: of the network.
        path: of the file.
        sha256: digest of the file, hexadecimal.
        precision: "fp32", "fp16", ...
        fixed_size: (height, width) of a fixed model; None = any.
        size_asked: as given to `Predictor`.
        trained_height: rows of the training frames; None = not known.
        canonical_focal_px: pixels; None = the model answers plain metres.
        heads: names of the outputs.
        max_depth_m: depth range in metres.
    """

    name: str
    path: str
    sha256: str
    precision: str
    fixed_size: tuple[int, int] | None
    size_asked: NetworkSize
    trained_height: int | None
    canonical_focal_px: float | None
    heads: tuple[str, ...]
    max_depth_m: float


@dataclass(frozen=True)
class ProviderFacts:
    """The execution provider.

    Attributes:
        asked: "cpu" or "cuda".
        running: ONNX Runtime's names of the providers of the session.
        nodes: provider -> nodes of the graph that it runs.
        threads: of inference.
    """

    asked: str
    running: tuple[str, ...]
    nodes: dict[str, int]
    threads: int


@dataclass(frozen=True)
class MachineFacts:
    """The computer and its Python."""

    cpu: str
    instruction_sets: tuple[str, ...]  # as the system reports them
    logical_cores: int | None
    system: str
    python: str

    @property
    def processor(self) -> str:
        """The processor with its instruction sets."""
        return f"{self.cpu} ({', '.join(self.instruction_sets) or 'no AVX2 reported'})"


@dataclass(frozen=True)
class EngineFacts:
    """What a report states about the engine; `dataclasses.asdict` makes it ready for JSON.

    Attributes:
        ssdnet: version of this package.
        model: the model file.
        provider: the execution provider.
        machine: the computer.
        load_ms: time of reading and optimising the model.
        first_inference_ms: time of the first prediction; None = there was none.
    """

    ssdnet: str
    model: ModelFacts
    provider: ProviderFacts
    machine: MachineFacts
    load_ms: float
    first_inference_ms: float | None


def engine_facts(predictor: "Predictor") -> EngineFacts:
    """Return the facts of a predictor and of this machine."""
    contract = predictor.contract
    return EngineFacts(
        ssdnet=runtime.__version__,
        model=ModelFacts(
            name=contract.model_name,
            path=predictor.model,
            sha256=predictor.digest,
            precision=contract.precision,
            fixed_size=(
                None if predictor.free_size else predictor.network_size(contract.native_size)
            ),
            size_asked=predictor.size if predictor.free_size else None,
            trained_height=contract.trained_height,
            canonical_focal_px=contract.canonical_focal_px,
            heads=predictor.heads,
            max_depth_m=contract.max_depth_m,
        ),
        provider=ProviderFacts(
            asked=predictor.provider,
            running=predictor.providers,
            nodes=predictor.node_counts,
            threads=predictor.threads,
        ),
        machine=machine_facts(),
        load_ms=predictor.load_ms,
        first_inference_ms=predictor.first_inference_ms,
    )


def machine_facts() -> MachineFacts:
    """Return the facts of this machine."""
    info = _cpu_info()
    flags = set(info.get("flags", "").split())
    return MachineFacts(
        cpu=info.get("model name") or platform.processor() or platform.machine(),
        instruction_sets=tuple(name for name, any_of in _SETS.items() if flags & any_of),
        logical_cores=os.cpu_count(),
        system=platform.platform(),
        python=platform.python_version(),
    )


def _cpu_info() -> dict[str, str]:
    """The values of the first processor in /proc/cpuinfo; empty where there is none."""
    try:
        first = _CPU_INFO.read_text().partition("\n\n")[0]
    except OSError:
        return {}
    pairs = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}
