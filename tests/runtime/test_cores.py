"""Physical cores, within the affinity of the process and its container's quota."""

import os
import sys

import pytest

import runtime.cores
from runtime.cores import available_cores

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system tells less")


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine of 16 processors, two of each core, of which the process may use those given."""

    def make(*, usable=range(16), quota="max 100000", topology=True):
        for cpu in range(16):
            if topology:
                (tmp_path / str(cpu)).write_text(f"{cpu % 8},{cpu % 8 + 8}\n")
        if quota is not None:
            (tmp_path / "cpu.max").write_text(quota + "\n")
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(usable))
        monkeypatch.setattr(runtime.cores, "_TOPOLOGY", str(tmp_path / "{}"))
        monkeypatch.setattr(runtime.cores, "_CGROUP_QUOTA", tmp_path / "cpu.max")
        monkeypatch.setattr(os, "cpu_count", lambda: 16)

    return make


@pytest.mark.parametrize(
    ("quota", "cores"),
    [
        ("max 100000", 8),
        ("300000 100000", 3),
        ("200001 100000", 3),
        (None, 8),  # no such file
        ("a b", 8),
    ],
)
def test_a_containers_quota(machine, quota, cores):
    machine(quota=quota)
    assert available_cores() == cores


@pytest.mark.parametrize(
    ("usable", "cores"), [(range(16), 8), ((0, 8), 1), ((0, 1), 2), ((3,), 1), ((0, 1, 8), 2)]
)
def test_threads_of_one_core_count_once(machine, usable, cores):
    machine(usable=usable)
    assert available_cores() == cores


def test_without_a_topology_every_processor_counts(machine):
    machine(usable=range(6), topology=False)
    assert available_cores() == 6
