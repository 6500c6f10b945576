"""Number of processor cores that this process may use."""

import math
import os
from pathlib import Path

_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
_CGROUP_QUOTA = Path("/sys/fs/cgroup/cpu.max")


def available_cores() -> int:
    """Return the number of physical cores this process may use, at least 1.

    Hyper-threads of one core count once, since they share its arithmetic units. The process's
    affinity and a container's CPU quota are respected where the system reports them.
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
    try:
        quota, period = _CGROUP_QUOTA.read_text().split()
        return math.ceil(int(quota) / int(period))
    except (OSError, ValueError):  # no cgroup v2, or "max": no limit
        return os.cpu_count() or 1
