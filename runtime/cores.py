"""Number of processor cores that this process may use."""

import math
import os
from pathlib import Path

_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
_CGROUPS, _MOUNTS = "/proc/self/cgroup", "/proc/self/mountinfo"


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
    """The least CPU quota from the process's cgroups up to the root; all cores without one."""
    # Controller -> the cgroup that is mounted, and where; version 2 has one tree, named "" here.
    mounts = {"": ("/", "/sys/fs/cgroup"), "cpu": ("/", "/sys/fs/cgroup/cpu")}
    for line in _read(_MOUNTS).splitlines():
        fields, _, kind = line.partition(" - cgroup")
        if kind.startswith("2 ") or "cpu" in kind.split(" ")[-1].split(","):
            _, _, _, root, mount, *_ = fields.split(" ")
            mounts["" if kind.startswith("2 ") else "cpu"] = root, mount
    least = os.cpu_count() or 1
    for line in _read(_CGROUPS).splitlines():
        _, controllers, cgroup = line.split(":", 2)
        for controller in mounts.keys() & controllers.split(","):
            root, mount = mounts[controller]
            inside = Path(cgroup).is_relative_to(root)  # else it lies above the container
            below = Path(cgroup).relative_to(root) if inside else Path()
            for folder in (Path(mount, each) for each in (below, *below.parents)):
                limit = _read(folder / "cpu.max") or " ".join(
                    _read(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period")
                )
                match limit.split():
                    case [quota, period] if quota.isdigit() and period.isdigit():
                        least = min(least, math.ceil(int(quota) / max(1, int(period))))
    return least


def _read(path: Path | str) -> str:
    """The text of a file of the kernel; "" without it."""
    try:
        return Path(path).read_text()
    except (OSError, ValueError):
        return ""
