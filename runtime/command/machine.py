"""The computer on which a command runs, as reports and pages state it."""

import os
import platform
from dataclasses import dataclass
from pathlib import Path

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
    load: float  # processes that ran or waited to run, over the last minute
    system: str
    python: str

    @property
    def processor(self) -> str:
        """The processor with its instruction sets."""
        return f"{self.cpu} ({', '.join(self.instruction_sets) or 'no AVX2 reported'})"


def machine_facts() -> MachineFacts:
    """Return the facts of this machine."""
    info = _cpu_info()
    flags = set(info.get("flags", "").split())
    return MachineFacts(
        cpu=info.get("model name") or platform.processor() or platform.machine(),
        instruction_sets=tuple(name for name, any_of in _SETS.items() if flags & any_of),
        logical_cores=os.cpu_count(),
        load=round(os.getloadavg()[0], 2),
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
