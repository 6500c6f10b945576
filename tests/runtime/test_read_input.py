"""Whatever stands at the path of an input: what is no regular file of bounded size is refused."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import runtime.read_input
from runtime import InputError
from runtime.errors import SSDNetError
from runtime.io.calibration import Calibration
from runtime.io.images import read_rgb, read_sparse_depth
from runtime.io.scan import read_scan
from runtime.model_file import load_model_file
from runtime.read_input import read_input, read_text, read_toml
from runtime.sources.ros_bag import RosBag
from runtime.sources.video import VideoSource

#: Every reader of a path gets what it cannot read, where 400 MB are left, and prints its error.
PROGRAM = """
import resource, sys
from pathlib import Path
import runtime.run.cli
from runtime import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import list_files, read_rgb, read_sparse_depth
from runtime.io.scan import read_scan
from runtime.sources.folders import FolderSource
from runtime.sources.kitti_raw import KittiRawSource
from runtime.sources.video import VideoSource

READERS = {
    "rgb": read_rgb,
    "depth": read_sparse_depth,
    "scan": read_scan,
    "calibration": Calibration.from_file,
    "video": VideoSource,
    "folder": lambda path: FolderSource(path / "none").list_frames(),
    "kitti-raw": lambda path: KittiRawSource(path / "none"),
}
try:
    import rosbags.highlevel
    from runtime.sources.bag import BagSource
    READERS["bag"] = BagSource
except ImportError:
    pass
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000,) * 2)
for path in sys.argv[1:]:
    for name, read in READERS.items():
        if (name, Path(path).stem) == ("scan", "kernel"):
            continue  # its size is 0: an empty scan
        try:
            read(Path(path))
        except InputError as error:
            print(name, flush=True)
        else:
            raise SystemExit(f"{name} took {path}")
print(len(READERS), len(sys.argv) - 1)
"""


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
@pytest.mark.parametrize("suffix", ["", ".toml", ".bag"])
def test_no_reader_waits_takes_memory_or_raises_another_error(tmp_path, suffix):
    paths = hostile_paths(tmp_path)
    if suffix:
        paths = [path.rename(f"{path}{suffix}") for path in paths[:4]]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, paths)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout[-300:] + done.stderr[-3000:]
    *lines, (readers, count) = (line.split() for line in done.stdout.splitlines())
    assert len(lines) == int(readers) * int(count) - 1
    assert int(count) == len(paths)


def test_a_zero_byte_in_a_name_is_an_input_error():
    for read in (read_input, read_text, read_toml):
        with pytest.raises(InputError, match="null byte"):
            read(Path("a\0b"))


def test_a_file_is_read_up_to_its_limit(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_input(path, max_bytes=5) == b"12345"
    with pytest.raises(InputError, match=r"a has 5 bytes, expected at most 4"):
        read_input(path, max_bytes=4)
    monkeypatch.setattr(runtime.read_input, "MAX_TEXT_BYTES", 4)
    with pytest.raises(InputError, match=r"a has 5 bytes, expected at most 4"):
        read_text(path)


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 9\n"


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.png", read_rgb),
        ("a.tif", read_sparse_depth),
        ("a.bin", read_scan),
        ("a.npy", read_scan),
        ("a.toml", Calibration.from_file),
        ("calib.txt", Calibration.from_file),
        ("a.mp4", VideoSource),
        ("a.mcap", RosBag),
        ("a.onnx", load_model_file),
    ],
)
def test_a_pointer_of_git_lfs_is_named(tmp_path, name, read):
    (tmp_path / name).write_bytes(POINTER)
    with pytest.raises(SSDNetError, match=r"is a pointer of Git LFS.*: get it by git lfs pull"):
        read(tmp_path / name)


@pytest.mark.parametrize("text", [POINTER[:20], POINTER + b"x" * 1024, b"# " + POINTER])
def test_a_text_like_a_pointer_is_read(tmp_path, text):
    (tmp_path / "a").write_bytes(text)
    assert read_input(tmp_path / "a") == text


def test_what_is_no_text_is_an_input_error(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="it is not UTF-8 text"):
        read_text(tmp_path / "a")


@pytest.mark.parametrize("text", ["a = " + "[" * 900, "a = " + "9" * 5000, "a = "])
def test_toml_is_read_or_an_input_error(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="not valid TOML"):
        read_toml(path)
