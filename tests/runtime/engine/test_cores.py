"""Physical cores, within the affinity of the process and its container's quota."""

import os
import sys

import pytest

import runtime.engine.cores
from runtime.engine.cores import available_cores

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system tells less")


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine of 16 processors, two of each core, of which the process may use those given."""

    def make(*, usable=range(16), topology=True, cgroups="", files=()):
        for cpu in range(16):
            if topology:
                (tmp_path / str(cpu)).write_text(f"{cpu % 8},{cpu % 8 + 8}\n")
        for name, text in dict(files).items():
            path = tmp_path / "sys" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")
        (tmp_path / "cgroup").write_text(cgroups)
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(usable))
        monkeypatch.setattr(runtime.engine.cores, "_TOPOLOGY", str(tmp_path / "{}"))
        monkeypatch.setattr(runtime.engine.cores, "_CGROUPS", tmp_path / "cgroup")
        monkeypatch.setattr(runtime.engine.cores, "_MOUNT", tmp_path / "sys")
        monkeypatch.setattr(os, "cpu_count", lambda: 16)

    return make


def v1(below, quota, period=100000, folder="cpu,cpuacct"):
    start = f"{folder}/{below}cpu.cfs_"
    return {f"{start}quota_us": str(quota), f"{start}period_us": str(period)}


@pytest.mark.parametrize(("cgroups", "files", "cores"), [
    ("0::/\n", {"cpu.max": "200001 100000"}, 3),
    ("0::/\n", {"cpu.max": "max 100000"}, 8),
    ("", {}, 8),
    # A service of systemd, and a slice above it: the least of them.
    ("0::/a.slice/b\n", {"a.slice/b/cpu.max": "200000 100000"}, 2),
    ("0::/a/b\n", {"a/cpu.max": "500000 100000", "a/b/cpu.max": "300000 100000"}, 3),
    ("0::/a\n", {"b/cpu.max": "100000 100000"}, 8),  # of others
    ("0::/../b\n", {"cpu.max": "100000 100000"}, 1),  # moved out of the container's cgroup
    # Docker with cgroups of version 1: the host's path, where the container's is mounted.
    ("4:cpu,cpuacct:/docker/id\n1:memory:/x\n", v1("", 250000), 3),
    ("4:cpuacct,cpu:/x\n0::/\n", v1("", 250000, folder="cpu"), 3),
    ("4:cpu,cpuacct:/x/y\n", {**v1("x/y/", 300000), **v1("x/", 200000)}, 2),
    ("4:cpu,cpuacct:/x\n", v1("x/", -1), 8),
    ("4:cpuset:/x\n1:cpu,cpuacct:/\n", v1("x/", 100000, folder="cpu"), 8),  # of others
])  # fmt: skip
def test_the_least_quota_from_the_cgroup_to_the_root(machine, cgroups, files, cores):
    machine(cgroups=cgroups, files=files)
    assert available_cores() == cores


@pytest.mark.parametrize(("usable", "cores"), [(range(16), 8), ((0, 8), 1), ((0, 1, 8), 2)])
def test_threads_of_one_core_count_once(machine, usable, cores):
    machine(usable=usable)
    assert available_cores() == cores


def test_without_a_topology_every_processor_counts(machine):
    machine(usable=range(6), topology=False)
    assert available_cores() == 6
