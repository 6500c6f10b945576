"""What tests of every part share."""

import shutil
import subprocess

import pytest


@pytest.fixture
def read_only():
    """Make folders read-only even for root: read_only(folder)."""
    mounted = []

    def mount(folder):
        command = ["mount", "--bind", str(folder), str(folder)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("mounting is not permitted here")
        mounted.append(folder)
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)

    yield mount
    for folder in mounted:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def mount_disk(tmp_path):
    """Mount real file systems of a few kilobytes: mount_disk(kilobytes) -> folder."""
    mounted = []

    def mount(kilobytes):
        disk = tmp_path / f"disk{len(mounted)}"
        disk.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(disk)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("mounting a small file system is not permitted here")
        mounted.append(disk)
        return disk

    yield mount
    for disk in mounted:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)  # a file may be open yet
