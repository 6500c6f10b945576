"""Number of processor cores that this process may use."""

import math
import os
from pathlib import Path

_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
_CGROUPS, _MOUNT = "/proc/self/cgroup", Path("/sys/fs/cgroup")


def available_cores() -> int:
    """Return the number of physical cores this process may use, at least 1.

    Hyper-threads of one core count once, since they share its arithmetic units. The process's
    affinity and the CPU quotas of its cgroups are respected where the system reports them.
    """
    try:
        logical = os.sched_getaffinity(0)
    except AttributeError:  # not Linux
        return os.cpu_count() or 1
    return max(1, min(_physical(logical), _quota()))


def _physical(logical: set[int]) -> int:
    try:
        return len({Path(_TOPOLOGY.format(cpu)).read_text() for cpu in logical})
    except OSError:
        return len(logical)


def _quota() -> int:
    """Return the smallest CPU quota of the process's cgroups, or all cores if there is none."""
    least = os.cpu_count() or 1
    for line in _read(_CGROUPS).splitlines():
        _, names, cgroup = line.split(":", 2)  # version 1 names the controllers
        mounts = {_MOUNT / names, _MOUNT / "cpu"} if "cpu" in names.split(",") else {_MOUNT}
        below = Path(cgroup.strip("/"))  # in a container, this may be the path on the host
        for folder in (mount / each for mount in mounts for each in (below, *below.parents)):
            limit = _read(folder / "cpu.max").split()
            limit += (_read(folder / f"cpu.cfs_{each}_us").strip() for each in ("quota", "period"))
            match limit:
                case [quota, period, *_] if quota.isdigit() and period.isdigit():
                    least = min(least, math.ceil(int(quota) / max(1, int(period))))
    return least


def _read(path: Path | str) -> str:
    """Return the text of a kernel file, or "" if there is no such file."""
    try:
        return Path(path).read_text()
    except (OSError, ValueError):
        return ""
