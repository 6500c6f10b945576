"""This process: the processor cores that it may use, and whether it was forked."""

import math
import os
from pathlib import Path

from runtime.errors import InferenceError

_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
_CGROUPS, _MOUNT = "/proc/self/cgroup", Path("/sys/fs/cgroup")


class ProcessGuard:
    """Remembers the process that made an object, whose threads do not survive a fork.

    what: names the object.
    """

    def __init__(self, what: str) -> None:
        self._what, self._process = what, os.getpid()

    @property
    def is_forked(self) -> bool:
        """Whether this is a child of that process."""
        return os.getpid() != self._process

    def check(self) -> None:
        """Raise InferenceError in a child."""
        if self.is_forked:
            raise InferenceError(
                f"the {self._what} was created before this process was forked, and threads do "
                f"not survive a fork: create a {self._what} in each process"
            )


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
    least = os.cpu_count() or 1
    for line in _read(_CGROUPS).splitlines():
        _, names, cgroup = line.split(":", 2)  # version 1 names the controllers
        mounts = {_MOUNT / names, _MOUNT / "cpu"} if "cpu" in names.split(",") else {_MOUNT}
        below = Path(cgroup.strip("/"))  # in a container perhaps as the host sees it
        for folder in (mount / each for mount in mounts for each in (below, *below.parents)):
            limit = _read(folder / "cpu.max").split()
            limit += (_read(folder / f"cpu.cfs_{each}_us").strip() for each in ("quota", "period"))
            match limit:
                case [quota, period, *_] if quota.isdigit() and period.isdigit():
                    least = min(least, math.ceil(int(quota) / max(1, int(period))))
    return least


def _read(path: Path | str) -> str:
    """The text of a file of the kernel; "" without it."""
    try:
        return Path(path).read_text()
    except (OSError, ValueError):
        return ""
