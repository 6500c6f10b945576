"""Files and folders are whole or not there, whatever happens while they are written."""

import os
import stat
import sys
from pathlib import Path

import pytest

from runtime import OutputError
from runtime.files.atomic_write import (
    atomic_file,
    atomic_path,
    atomic_write,
    remove_leftover,
    require_writable,
)
from runtime.files.own_folder import MARKER, atomic_folder, locked_folder


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def write_file(path, fill, **options):
    with atomic_file(path, **options) as file:
        fill(Path(file.name))


def write_path(path, fill, **options):
    with atomic_path(path, **options) as made:
        fill(made)


def write_folder(path, fill):
    with atomic_folder(path) as folder:
        fill(folder / "file")


WRITES = [write_file, write_path, write_folder]


@pytest.mark.parametrize("write", WRITES)
def test_a_name_is_there_only_when_the_whole_is(tmp_path, write):
    path = tmp_path / "a.bin"

    def fill(made):
        made.write_bytes(b"half")
        assert not path.exists()
        made.write_bytes(b"new")

    write(path, fill)
    assert (path / "file" if write is write_folder else path).read_bytes() == b"new"
    assert names_in(tmp_path) == ["a.bin"]


def test_the_old_file_stays_until_then(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write(path, b"old")
    with atomic_file(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
        assert Path(file.name).read_bytes() == b"new", "it can be verified before"
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_permissions_are_what_the_umask_leaves(tmp_path, umask):
    path, before = tmp_path / "a.bin", os.umask(umask)
    try:
        path.touch(0o600)
        atomic_write(path, b"content")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("length", [1, 41, 251])
def test_names_of_any_length(tmp_path, length):
    first, second = (tmp_path / ("n" * (length - 1) + letter + ".png") for letter in "ab")
    with atomic_file(first) as one, atomic_file(second) as other:
        one.write(b"1")
        other.write(b"2")
    assert first.read_bytes() + second.read_bytes() == b"12"


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"foreign")
    (tmp_path / "a.bin").symlink_to(tmp_path / "elsewhere")
    atomic_write(tmp_path / "a.bin", b"content")
    assert (tmp_path / "elsewhere").read_bytes() == b"foreign"
    assert not (tmp_path / "a.bin").is_symlink()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("write", WRITES)
def test_an_error_leaves_no_trace_and_the_old_file(tmp_path, write, error):
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


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    for place in ("file/a.bin", "none/a.bin"):
        with pytest.raises(OutputError, match="cannot write"):
            atomic_write(tmp_path / place, b"content")
        with pytest.raises(OutputError, match="cannot write"):
            require_writable(tmp_path / place)
    with pytest.raises(OutputError, match="is a folder"):
        require_writable(tmp_path)


WRITER = """
import sys
from pathlib import Path
from runtime.files.atomic_write import temporary_path
with temporary_path(Path(sys.argv[1])) as made:
    made.touch()
    print("half", flush=True)
    sys.stdin.readline()
"""


def test_what_another_process_is_writing_stays_and_what_it_left_goes(tmp_path, start_process):
    path = tmp_path / "a"
    process = start_process(sys.executable, "-c", WRITER, path)
    assert process.stdout.readline() == "half\n"
    remove_leftover(path)
    with pytest.raises(OutputError, match="another process is writing it at this moment"):
        atomic_write(path, b"content")
    (left,) = tmp_path.iterdir()
    process.kill()
    process.wait()
    remove_leftover(tmp_path / "b")
    assert left.exists()
    atomic_write(path, b"content")
    assert names_in(tmp_path) == ["a"]
    left.mkdir()
    remove_leftover(path)
    assert not left.exists()


@pytest.mark.parametrize("write", [write_file, write_path])
def test_without_overwriting_a_file_that_came_meanwhile_stays(tmp_path, write):
    path = tmp_path / "a.bin"

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


def test_a_library_that_writes_nothing_leaves_no_older_file(tmp_path):
    path = tmp_path / "deep" / "a.mp4"
    write_path(path, lambda made: made.write_bytes(b"old"))
    write_path(path, lambda made: None)
    assert names_in(path.parent) == []


@pytest.mark.parametrize("write", [write_file, write_path])
def test_what_is_no_regular_file_is_never_replaced(tmp_path, write):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="no regular file"):
        write(tmp_path / "pipe", lambda made: made.write_bytes(b"new"))
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert names_in(tmp_path) == ["pipe"]


def test_a_folder_is_replaced_only_when_asked(tmp_path):
    path = tmp_path / "deep" / "a"

    def write(name, **options):
        with atomic_folder(path, **options) as folder:
            (folder / name).mkdir()
            (folder / name / "file").touch()

    write("old")
    with pytest.raises(OutputError, match="exists"):
        write("new")
    assert names_in(path) == [MARKER, "old"]
    write("new", overwrite=True)
    assert names_in(path) == [MARKER, "new"]
    assert names_in(path.parent) == ["a"]


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
    (tmp_path / "alias").symlink_to(path)
    with pytest.raises(OutputError, match="is a link"):
        atomic_folder(tmp_path / "alias", overwrite=True).__enter__()


def test_two_processes_do_not_write_into_one_folder(tmp_path):
    """A lock belongs to an open file, so one process can hold two like two processes."""
    with locked_folder(tmp_path / "a/out"):
        with pytest.raises(OutputError, match=r"another run is writing into .*out"):
            locked_folder(tmp_path / "a/out").__enter__()
        with locked_folder(tmp_path / "b"):
            pass
    with locked_folder(tmp_path / "a/out"):
        pass
