"""Whatever stands at the path of an input: what is no regular file of bounded size is refused."""

import os
import resource
import signal
import sys
from pathlib import Path

import pytest

import runtime.files.read_input
from runtime import InputError
from runtime.base.errors import SSDNetError
from runtime.contract.model_file import load_model_file
from runtime.files.read_input import read_input, read_text, read_toml
from runtime.geometry.calibration import Calibration
from runtime.recordings.bag import BagSource
from runtime.recordings.images import read_rgb
from runtime.recordings.scan import read_scan
from runtime.recordings.video import VideoSource

READERS = {
    "rgb": read_rgb, "scan": read_scan, "calibration": Calibration.from_file, "video": VideoSource,
    "bag": BagSource,
}  # fmt: skip


@pytest.fixture
def limited():
    """Leave 400 MB of memory, and 60 s."""

    def expire(*_):
        pytest.fail("waits")

    memory, expired = resource.getrlimit(resource.RLIMIT_AS), signal.signal(signal.SIGALRM, expire)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000, memory[1]))
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, expired)
    resource.setrlimit(resource.RLIMIT_AS, memory)


def hostile_paths(folder: Path) -> list[Path]:
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "kernel").symlink_to("/proc/kmsg")  # a regular file, of which reading waits
    (folder / "loop").symlink_to("loop")
    (folder / "folder").mkdir()
    sparse = folder / "sparse"
    sparse.touch()
    os.truncate(sparse, 100_000_000_000)
    names = ("pipe", "zero", "kernel", "loop", "folder", "n" * 256, "missing", "sparse")
    return [folder / name for name in names]


@pytest.mark.skipif(sys.platform != "linux", reason="needs RLIMIT_AS and /proc")
@pytest.mark.parametrize("reader", READERS)
def test_no_reader_waits_takes_memory_or_raises_another_error(tmp_path, limited, reader):
    for path in hostile_paths(tmp_path):
        if (reader, path.stem) != ("scan", "kernel"):  # its size is 0: an empty scan
            with pytest.raises(InputError):
                READERS[reader](path)


def test_a_zero_byte_in_a_name_is_an_input_error():
    for read in (read_input, read_text, read_toml):
        with pytest.raises(InputError, match="null byte"):
            read(Path("a\0b"))


def test_a_file_is_read_up_to_its_limit(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_input(path, max_bytes=5) == b"12345"
    with pytest.raises(InputError, match="at most 4"):
        read_input(path, max_bytes=4)
    monkeypatch.setattr(runtime.files.read_input, "MAX_TEXT_BYTES", 4)
    with pytest.raises(InputError, match="at most 4"):
        read_text(path)


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 9\n"


@pytest.mark.parametrize(("name", "read"), [("a.npy", read_scan), ("a.onnx", load_model_file)])
def test_a_pointer_of_git_lfs_is_named(tmp_path, name, read):
    (tmp_path / name).write_bytes(POINTER)
    with pytest.raises(SSDNetError, match="git lfs pull"):
        read(tmp_path / name)


@pytest.mark.parametrize("text", [POINTER[:20], POINTER + b"x" * 1024, b"# " + POINTER])
def test_a_text_like_a_pointer_is_read(tmp_path, text):
    (tmp_path / "a").write_bytes(text)
    assert read_input(tmp_path / "a") == text


def test_what_is_no_text_is_an_input_error(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="it is not UTF-8 text"):
        read_text(tmp_path / "a")


@pytest.mark.parametrize("text", ["a = " + "[" * 900, "a = " + "9" * 5000])
def test_toml_is_read_or_an_input_error(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="not valid TOML"):
        read_toml(path)
