"""What a report states about the model, the execution provider, and the machine."""

import os
import platform
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import runtime

if TYPE_CHECKING:
    from runtime.engine.predictor import Predictor

_LIBRARIES = ("onnxruntime", "cv2", "numpy")  # libraries that a predictor loads
_CPU_INFO = Path("/proc/cpuinfo")
# Instruction sets that decide how fast a network runs, and the flags of Linux that indicate each.
_SETS = {
    "AVX2": {"avx2"},
    "AVX-512": {"avx512f"},
    "VNNI": {"avx_vnni", "avx512_vnni"},
    "AMX": {"amx_tile"},
}


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


def engine_facts(predictor: "Predictor") -> dict[str, Any]:
    """Return what a report states about a predictor and this machine, ready for JSON.

    Returns:
        "ssdnet", the version of this package; "model", the file and how it is run, with sizes as
        (height, width) and lengths in pixels; "provider", the requested provider, the providers of
        the session with the number of graph nodes that each runs, and the threads of inference;
        "machine", see `MachineFacts`; "libraries", the versions by import name; "load_ms", the time
        of reading and optimising the model; and "first_inference_ms". A value is None if it is
        unknown or does not exist.
    """
    contract, is_free = predictor.contract, predictor.free_size
    return {
        "ssdnet": runtime.__version__,
        "model": {
            "name": contract.model_name,
            "path": str(predictor.model.path),
            "sha256": predictor.digest,
            "precision": contract.precision,
            "fixed_size": None if is_free else predictor.network_size(contract.native_size),
            "size_asked": predictor.size if is_free else None,
            "trained_height": contract.trained_height,
            "canonical_focal_px": contract.canonical_focal_px,
            "heads": predictor.heads,
            "max_depth_m": contract.max_depth_m,
        },
        "provider": {
            "asked": predictor.provider,
            "running": predictor.providers,
            "nodes": predictor.node_counts,
            "threads": predictor.threads,
        },
        "machine": asdict(machine_facts()),
        "libraries": {name: sys.modules[name].__version__ for name in _LIBRARIES},
        "load_ms": predictor.load_ms,
        "first_inference_ms": predictor.first_inference_ms,
    }


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
    """The values of the first processor in /proc/cpuinfo; empty if there is no such file."""
    try:
        first = _CPU_INFO.read_text().partition("\n\n")[0]
    except OSError:
        return {}
    pairs = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}
