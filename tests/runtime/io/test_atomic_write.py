"""Files and folders are whole or not there, whatever happens while they are written."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from runtime import OutputError
from runtime.io.atomic_write import (
    atomic_file,
    atomic_path,
    atomic_write,
    remove_leftover,
)
from runtime.io.own_folder import MARKER, atomic_folder


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def with_umask():
    """Set the umask; the one before comes back."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


@pytest.fixture
def writer_in_another_process():
    """Start a process that has written half of a file (or folder) and waits for a line."""
    started = []

    def start(path, call="atomic_file(path)"):
        fill = {
            "atomic_file": "target.write(b'half'); target.flush()",
            "atomic_folder": "(target / 'half').touch()",
            "atomic_path": "target.write_bytes(b'half')",
        }
        program = (
            "import sys; from pathlib import Path; from runtime.io.atomic_write import *\n"
            "from runtime.io.own_folder import *\n"
            f"path = Path({str(path)!r})\n"
            f"with {call} as target:\n"
            f"    {fill[call.partition('(')[0]]}; print('half', flush=True); sys.stdin.readline()\n"
            "print('whole', flush=True)"
        )
        process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout.readline() == "half\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_file_has_its_name_only_when_it_is_whole(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write(path, b"old")
    with atomic_file(path) as file:
        file.write(b"half")
        file.flush()
        assert path.read_bytes() == b"old"
        with open(file.name, "rb") as other:  # as who verifies it before it is published
            assert other.read() == b"half"
        file.seek(0)
        file.truncate()
        file.write(b"new")
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_permissions_are_what_the_umask_leaves(tmp_path, with_umask, umask):
    path = tmp_path / "a.bin"
    path.touch(0o600)
    with_umask(umask)
    atomic_write(path, b"content")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("length", [1, 40, 41, 251])
def test_names_of_any_length(tmp_path, length):
    first, second = (tmp_path / ("n" * (length - 1) + letter + ".png") for letter in "ab")
    with atomic_file(first) as one, atomic_file(second) as other:
        one.write(b"1")
        other.write(b"2")
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")
    assert names_in(tmp_path) == [first.name, second.name]


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"foreign")
    (tmp_path / "a.bin").symlink_to(tmp_path / "elsewhere")
    atomic_write(tmp_path / "a.bin", b"content")
    assert (tmp_path / "elsewhere").read_bytes() == b"foreign"
    assert not (tmp_path / "a.bin").is_symlink()


def write_file(path, fill, **options):
    with atomic_file(path, **options) as file:
        fill(Path(file.name))


def write_path(path, fill, **options):
    with atomic_path(path, **options) as made:
        fill(made)


def write_folder(path, fill):
    with atomic_folder(path) as folder:
        fill(folder / "file")


# --- what goes wrong ---------------------------------------------------------------------------


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("write", [write_file, write_path, write_folder])
def test_an_error_in_the_block_leaves_no_trace_and_the_old_file(tmp_path, write, error):
    path = tmp_path / "a.bin"
    before = [] if write is write_folder else ["a.bin"]
    for name in before:
        (tmp_path / name).write_bytes(b"old")

    def fail(made):
        made.write_bytes(b"half")
        raise error

    with pytest.raises(OutputError if isinstance(error, OSError) else KeyboardInterrupt):
        write(path, fail)
    assert names_in(tmp_path) == before
    assert not before or path.read_bytes() == b"old"


def test_a_full_disk_leaves_the_old_file_and_no_trace(mount_disk):
    path = mount_disk(64) / "a.bin"
    atomic_write(path, b"old")
    with pytest.raises(OutputError, match=r"No space left on device.*are kept"):
        atomic_write(path, b"n" * 100_000)
    assert path.read_bytes() == b"old"
    assert names_in(path.parent) == ["a.bin"]


def test_a_folder_that_is_none(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"cannot write .*Not a directory"):
        atomic_write(tmp_path / "file" / "a.bin", b"content")
    with pytest.raises(OutputError, match=r"cannot write .*No such file"):
        atomic_write(tmp_path / "none" / "a.bin", b"content")


# --- processes that are killed, and those that are not -----------------------------------------


@pytest.mark.parametrize("call", ["atomic_file(path)", "atomic_folder(path)", "atomic_path(path)"])
@pytest.mark.parametrize("by_write", [True, False])
def test_what_a_killed_process_left_is_removed_by_the_next_write(
    tmp_path, writer_in_another_process, call, by_write
):
    path = tmp_path / "a"
    process = writer_in_another_process(path, call)
    process.kill()
    process.wait()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".a.")
    remove_leftover(tmp_path / "b")
    assert left.exists()
    if not by_write:
        remove_leftover(path)
        assert names_in(tmp_path) == []
    elif "folder" in call:
        with atomic_folder(path):
            pass
        assert names_in(tmp_path) == ["a"]
    else:
        atomic_write(path, b"content")
        assert names_in(tmp_path) == ["a"]


@pytest.mark.parametrize("call", ["atomic_file(path)", "atomic_folder(path)", "atomic_path(path)"])
def test_what_another_process_is_writing_stays(tmp_path, writer_in_another_process, call):
    path = tmp_path / "a"
    process = writer_in_another_process(path, call)
    remove_leftover(path)
    with pytest.raises(OutputError, match="another process is writing it at this moment"):
        atomic_write(path, b"content")
    assert process.communicate("go on\n")[0] == "whole\n"
    assert names_in(tmp_path) == ["a"]
    assert path.is_dir() if "folder" in call else path.read_bytes() == b"half"


# --- without overwriting -----------------------------------------------------------------------


@pytest.mark.parametrize("write", [write_file, write_path])
@pytest.mark.parametrize("hard_links", [True, False])
def test_without_overwriting_a_file_that_came_meanwhile_stays(
    tmp_path, monkeypatch, write, hard_links
):
    path = tmp_path / "a.bin"
    if not hard_links:

        def refuse(*_):
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(os, "link", refuse)

    def overtaken(made):
        made.write_bytes(b"second")
        path.write_bytes(b"first")

    with pytest.raises(OutputError, match=r"a\.bin exists"):
        write(path, overtaken, overwrite=False)
    assert path.read_bytes() == b"first"
    path.unlink()
    write(path, lambda made: made.write_bytes(b"third"), overwrite=False)
    assert path.read_bytes() == b"third"
    assert names_in(tmp_path) == ["a.bin"]


def test_of_many_racers_one_succeeds(tmp_path):
    """All wait for one pipe to close, then write the same path."""
    program = (
        "import sys; from pathlib import Path\n"
        "from runtime import OutputError; from runtime.io.atomic_write import atomic_write\n"
        "print('ready', flush=True); sys.stdin.readline()\n"
        "won = 0\n"
        "for name in range(200):\n"
        "    try: atomic_write(Path(sys.argv[1]) / str(name), sys.argv[2].encode(),"
        " overwrite=False); won += 1\n"
        "    except OutputError: pass\n"
        "print(won)"
    )
    gate, opener = os.pipe()
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", program, tmp_path, racer],
            stdin=gate,
            stdout=subprocess.PIPE,
            text=True,
        )
        for racer in "abc"
    ]
    os.close(gate)
    for racer in racers:
        assert racer.stdout.readline() == "ready\n"
    os.close(opener)
    wins = [int(racer.communicate()[0]) for racer in racers]
    assert sum(wins) == 200
    assert names_in(tmp_path) == sorted(str(name) for name in range(200))
    content = [path.read_text() for path in tmp_path.iterdir()]
    assert wins == [content.count(racer) for racer in "abc"]


# --- folders -----------------------------------------------------------------------------------


def test_a_folder_has_its_name_only_when_it_is_whole(tmp_path):
    path = tmp_path / "deep" / "a"
    with atomic_folder(path) as folder:
        (folder / "file").write_text("new")
        assert not path.exists()
    assert names_in(path) == [MARKER, "file"]
    assert names_in(path.parent) == ["a"]


def test_a_folder_is_replaced_only_when_asked(tmp_path):
    path = tmp_path / "a"

    def write(name, **options):
        with atomic_folder(path, **options) as folder:
            (folder / name).mkdir()
            (folder / name / "file").touch()

    write("old")
    with pytest.raises(OutputError, match="exists"):
        write("new")
    assert names_in(path) == [MARKER, "old"]
    assert names_in(tmp_path) == ["a"]
    write("new", overwrite=True)
    assert names_in(path) == [MARKER, "new"]


@pytest.mark.parametrize("foreign", ["thesis.txt", "deep", "link", "own/thesis.txt", MARKER])
def test_a_folder_with_a_foreign_entry_is_not_replaced(tmp_path, foreign):
    path = tmp_path / "a"
    with atomic_folder(path) as folder:
        for name in ("old", "link"):
            (folder / name).write_text("old")
        (folder / "own").mkdir()
    if foreign == MARKER:  # a folder that was not made here
        (path / foreign).unlink()
    elif foreign == "deep":
        (path / foreign).mkdir()
    elif foreign == "link":
        (path / foreign).unlink()
        (path / foreign).symlink_to(path / "old")
    else:
        (path / foreign).write_text("mine")
    before = sorted(path.rglob("*"))
    text = "did not write" if foreign == MARKER else "does not belong to the result"
    with pytest.raises(OutputError, match=text), atomic_folder(path, overwrite=True):
        pass
    assert sorted(path.rglob("*")) == before
    assert (path / "old").read_text() == "old"


def test_a_link_to_a_folder_is_not_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "a").symlink_to(tmp_path / "real")
    with (
        pytest.raises(OutputError, match="is a link"),
        atomic_folder(tmp_path / "a", overwrite=True),
    ):
        pass
    assert (tmp_path / "a").is_symlink()


# --- files of libraries that open them by name --------------------------------------------------


def test_a_named_file_has_its_place_only_when_it_is_whole(tmp_path):
    path = tmp_path / "deep" / "a.mp4"
    with atomic_path(path) as made:
        assert made.name == "a.mp4"
        made.write_bytes(b"half")
        assert not path.exists()
        made.write_bytes(b"new")
    assert path.read_bytes() == b"new"
    assert names_in(path.parent) == ["a.mp4"]


@pytest.fixture
def device(tmp_path):
    """A device file, which root may replace, else a pipe."""
    path = tmp_path / "device"
    if os.geteuid() == 0:
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))
    else:
        os.mkfifo(path)
    return path


@pytest.mark.parametrize("write", [write_file, write_path])
def test_what_is_no_regular_file_is_never_replaced(device, write):
    before = os.lstat(device)
    with pytest.raises(OutputError, match="no regular file"):
        write(device, lambda made: made.write_bytes(b"new"))
    assert os.path.samestat(before, os.lstat(device))
    assert list(device.parent.iterdir()) == [device]
