"""A recording comes back as it was written, whole or not at all, and damage is reported."""

import io
import json
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from runtime import ContractError, InputError, OutputError
from runtime.io.recording import RecordedFrame, Settings, read_recording, record

SETTINGS = Settings("the-test", size=(48, 64), focal_length_px=300.0)


@pytest.fixture
def recording(tmp_path, model_file, make_frame) -> Path:
    folder = tmp_path / "recording"
    with record(folder, SETTINGS) as recorder:
        for index in range(2):
            rgb, depth = make_frame(seed=index)
            frame = RecordedFrame(f"frame {index}", index == 0, ("no_depth",), 12.5)
            recorder.add(frame, rgb, depth, {"depth": depth + 1})
        recorder.finish(model_file())
    return folder


def test_what_was_recorded_comes_back(recording, model_file, make_frame, contract):
    read = read_recording(recording)
    assert read.settings == SETTINGS
    assert read.model.read_bytes() == model_file("again.onnx").read_bytes()
    assert read.model_name == contract.model_name
    assert read.limits == {"depth": {"max_abs_m": pytest.approx(5e-5 * contract.max_depth_m)}}
    assert read.frames[0] == RecordedFrame("frame 0", True, ("no_depth",), 12.5)
    rgb, depth = make_frame(seed=0)
    arrays = read.arrays(0)
    np.testing.assert_array_equal(arrays["rgb"], rgb)
    np.testing.assert_array_equal(arrays["sparse_depth"], depth)
    np.testing.assert_array_equal(arrays["depth"], depth + 1)
    assert read.arrays(1).keys() == {"rgb", "sparse_depth"}, "an invalid answer is not kept"


def test_after_an_error_there_is_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), record(tmp_path / "new", SETTINGS):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_was_replaced_meanwhile_is_refused(tmp_path, model_file):
    with (
        pytest.raises(ContractError, match="expected"),
        record(tmp_path / "r", SETTINGS) as r,
    ):
        r.finish(model_file(), sha256="0" * 64)


def test_nothing_but_an_older_recording_is_replaced(recording, tmp_path, model_file):
    with pytest.raises(OutputError, match="exists"), record(recording, SETTINGS):
        pass
    others = tmp_path / "others"
    others.mkdir()
    (others / "keep.txt").touch()
    with (
        pytest.raises(OutputError, match="not a recording"),
        record(others, SETTINGS, overwrite=True),
    ):
        pass
    assert (others / "keep.txt").exists()
    with record(recording, SETTINGS, overwrite=True) as recorder:
        recorder.finish(model_file())
    assert read_recording(recording).frames == ()


def edit(folder, **changes):
    path = folder / "recording.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "another"},
        {"version": "1.0"},
        {"version": "3.0"},
        {"version": None},
        {"settings": {"size": None}},
        {"settings": []},
        {"model": None},
        {"limits": None},
        *(
            {"limits": {"depth": limits}}
            for limits in (
                {},
                1,
                {"agreement": 1},
                {"max_abs_m": 10**400},
                {"max_abs_m": "1"},
                {"max_abs_m": float("nan")},
                {"max_abs_m": -1},
            )
        ),
        {"limits": {"speed": {"max_abs": 1}}},
        {"frames": [{"name": "x"}]},
        {"frames": 7},
        {"frames": [{"name": "x", "valid": True, "degraded": 3, "predict_ms": 1}]},
    ],
    ids=str,
)
def test_a_document_that_was_changed_is_refused(recording, changes):
    edit(recording, **changes)
    with pytest.raises(InputError, match="is not a valid recording"):
        read_recording(recording)


@pytest.mark.parametrize(("content", "message"), [(b"{", "not JSON"), (None, "cannot read")])
def test_a_folder_that_is_no_recording_is_refused(recording, content, message):
    path = recording / "recording.json"
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_recording(recording)


def test_damaged_arrays_are_refused(recording):
    path = recording / "frames" / "000000.npz"
    whole = path.read_bytes()
    read = read_recording(recording)
    random = np.random.default_rng(0)
    start = whole.index(b"sparse_depth.npy")
    for _ in range(20):  # in the middle of an array: its checksum tells
        damaged = bytearray(whole)
        damaged[start + 200 + int(random.integers(8000))] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged"):
            read.arrays(0)
    for content in (whole[: len(whole) // 2], b"", b"PK\x03\x04"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            read.arrays(0)


def test_a_frame_may_have_so_many_bytes(recording, monkeypatch):
    size = (recording / "frames" / "000000.npz").stat().st_size
    monkeypatch.setattr("runtime.io.recording.MAX_FRAME_BYTES", size)
    read_recording(recording).arrays(0)
    monkeypatch.setattr("runtime.io.recording.MAX_FRAME_BYTES", size - 1)
    with pytest.raises(InputError, match=rf"has {size:,} bytes, expected at most {size - 1:,}"):
        read_recording(recording).arrays(0)


def pack(path, compression=zipfile.ZIP_STORED, **contents):
    """Write members as they are: (name without .npy) -> bytes or an array."""
    with zipfile.ZipFile(path, "w", compression) as packed:
        for name, content in contents.items():
            if isinstance(content, np.ndarray):
                stream = io.BytesIO()
                np.save(stream, content)
                content = stream.getvalue()
            packed.writestr(f"{name}.npy", content)


@pytest.mark.parametrize("method", ["ZIP_DEFLATED", "ZIP_BZIP2", "ZIP_LZMA"])
def test_a_frame_that_is_compressed_is_refused(recording, make_frame, monkeypatch, method):
    """A small file could unpack to gigabytes; recordings are never compressed."""
    rgb, depth = make_frame()
    path = recording / "frames" / "000000.npz"
    bomb = np.zeros(2**20, np.uint8)
    pack(path, getattr(zipfile, method), rgb=rgb, sparse_depth=depth, depth=bomb)
    read = read_recording(recording)
    monkeypatch.setattr(np, "load", None)  # not even opened
    with pytest.raises(InputError, match="its arrays are compressed"):
        read.arrays(0)


def encrypted(content):
    """Set the flag of an encrypted member in every header."""
    changed = bytearray(content)
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = -1
        while (place := content.find(mark, place + 1)) >= 0:
            changed[place + at] |= 1
    return bytes(changed)


def header(text):
    """An array of 16 bytes with this header."""
    text = text.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(16)


TAMPERED = {
    "bytes": b"no array",
    "nothing": b"",
    "no header": b"\x93NUMPY\x01\x00\xff\xff",
    "tokens": header("{'descr': '<f4', 'fortran_order': False, 'shape': (4,"),
    "indents": header("  {\n 'descr'\n    : '<f4'\n  }"),
    "nested": header("(" * 110),
    "dtype": header("{'descr': 'Q' * 3, 'fortran_order': False, 'shape': (4,)}"),
    "shape": header("{'descr': '<f4', 'fortran_order': False, 'shape': (-4,)}"),
    "huge": header("{'descr': '<f4', 'fortran_order': False, 'shape': (9999999, 9999999)}"),
    "objects": header("{'descr': '|O', 'fortran_order': False, 'shape': (4,)}"),
}


@pytest.mark.parametrize("content", TAMPERED.values(), ids=TAMPERED)
def test_a_member_that_is_tampered_with_is_an_input_error(recording, make_frame, content):
    rgb, depth = make_frame()
    path = recording / "frames" / "000000.npz"
    pack(path, rgb=rgb, sparse_depth=depth, depth=content)
    with pytest.raises(InputError, match=r"000000\.npz .*the recording is damaged, get it again"):
        read_recording(recording).arrays(0)


def test_an_encrypted_frame_and_a_doubled_member_are_input_errors(recording, make_frame):
    path = recording / "frames" / "000000.npz"
    read = read_recording(recording)
    path.write_bytes(encrypted(path.read_bytes()))
    with pytest.raises(InputError, match="the recording is damaged"):
        read.arrays(0)
    rgb, depth = make_frame()
    pack(path, rgb=rgb, sparse_depth=depth, depth=depth)
    with zipfile.ZipFile(path, "a") as packed, pytest.warns(UserWarning, match="Duplicate"):
        packed.writestr("depth.npy", b"")
    with pytest.raises(InputError, match="it holds"):
        read.arrays(0)


def test_a_frame_that_is_tampered_with_anywhere_is_arrays_or_an_input_error(recording):
    path = recording / "frames" / "000000.npz"
    whole = np.frombuffer(path.read_bytes(), np.uint8)
    read, random = read_recording(recording), np.random.default_rng(0)
    heads = [np.flatnonzero(whole == ord("P")), np.flatnonzero(whole == 0x93)]
    places = np.unique(np.concatenate(heads)[:, None] + np.arange(80)).clip(max=len(whole) - 1)
    refused = 0
    for _ in range(300):  # in the headers of the archive and of its arrays
        changed = whole.copy()
        changed[random.choice(places, 3)] = random.integers(256, size=3)
        path.write_bytes(changed.tobytes())
        try:
            read.arrays(0)
        except InputError:
            refused += 1
    assert refused > 100


@pytest.mark.skipif(sys.platform != "linux", reason="needs RLIMIT_AS")
@pytest.mark.parametrize("name", ["recording.json", "frames/000000.npz"])
def test_special_files_are_neither_waited_for_nor_read_without_end(recording, name):
    program = (
        "import resource, sys; from pathlib import Path\n"
        "from runtime import InputError; from runtime.io.recording import read_recording\n"
        "used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 300_000_000,) * 2)\n"
        "try: read_recording(Path(sys.argv[1])).arrays(0)\n"
        "except InputError as error: print(error)\n"
    )
    for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
        (recording / name).unlink()
        make(recording / name)
        command = [sys.executable, "-c", program, str(recording)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert "not a regular file" in done.stdout, done.stderr


def test_a_header_that_asks_for_more_than_there_is_is_refused(recording):
    header = io.BytesIO()
    shape = {"descr": "|u1", "fortran_order": False, "shape": (10**15,)}
    np.lib.format.write_array_header_1_0(header, shape)
    with zipfile.ZipFile(recording / "frames" / "000000.npz", "w") as packed:
        for name in ("rgb", "sparse_depth", "depth"):
            packed.writestr(f"{name}.npy", header.getvalue())
    with pytest.raises(InputError, match="damaged"):
        read_recording(recording).arrays(0)


def test_other_arrays_and_pickles_are_refused(recording, make_frame):
    path = recording / "frames" / "000000.npz"
    read = read_recording(recording)
    rgb, depth = make_frame()
    np.savez(path, rgb=rgb, sparse_depth=depth)
    with pytest.raises(InputError, match=r"expected .*'depth'"):
        read.arrays(0)
    np.savez(path, rgb=rgb, sparse_depth=depth, depth=np.array([Exception()], object))
    with pytest.raises(InputError, match="allow_pickle"):
        read.arrays(0)
    path.write_bytes(pickle.dumps({"rgb": 1}))
    with pytest.raises(InputError, match="damaged"):
        read.arrays(0)


def overwrite(recording, model):
    with record(recording, SETTINGS, overwrite=True) as recorder:
        recorder.finish(model)


@pytest.mark.parametrize("name", ["thesis.txt", "frames/mine.npz", "frames/000002.npz", "deep/x"])
def test_a_recording_with_a_foreign_file_is_not_replaced(recording, model_file, name):
    (recording / name).parent.mkdir(exist_ok=True)
    (recording / name).write_text("mine")
    before = {path: path.read_bytes() for path in recording.rglob("*") if path.is_file()}
    with pytest.raises(
        OutputError, match=r"(thesis|mine|000002|deep)[.a-z]* does not belong to the"
    ):
        overwrite(recording, model_file())
    assert before == {path: path.read_bytes() for path in recording.rglob("*") if path.is_file()}


def test_a_foreign_file_that_appears_while_it_is_written_stays(recording, model_file):
    before = (recording / "recording.json").read_bytes()
    model = model_file()

    def write():
        with record(recording, SETTINGS, overwrite=True) as recorder:
            recorder.finish(model)
            (recording / "thesis.txt").write_text("mine")

    with pytest.raises(OutputError, match=r"thesis\.txt"):
        write()
    assert (recording / "thesis.txt").read_text() == "mine"
    assert (recording / "recording.json").read_bytes() == before


@pytest.mark.parametrize("content", ["{}", "", "[1]"])
def test_a_folder_with_another_document_of_that_name_is_not_replaced(tmp_path, model_file, content):
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "recording.json").write_text(content)
    with pytest.raises(OutputError, match="not a recording"):
        overwrite(folder, model_file())
    assert (folder / "recording.json").read_text() == content


def test_a_link_to_a_recording_is_not_replaced(recording, tmp_path, model_file):
    (tmp_path / "link").symlink_to(recording)
    with pytest.raises(OutputError, match="is a link"):
        overwrite(tmp_path / "link", model_file())
    assert len(read_recording(recording).frames) == 2


def test_a_name_that_is_too_long_is_an_output_error(tmp_path, model_file):
    with pytest.raises(OutputError, match="too long"):
        overwrite(tmp_path / ("n" * 256), model_file())


@pytest.mark.parametrize("killed_after", range(6))
def test_a_removal_that_was_killed_at_any_moment_is_finished_by_the_next(
    recording, model_file, monkeypatch, killed_after
):
    """The rest of the older recording is still known for what it is, and replaced."""
    assert len(list(recording.rglob("*"))) == 5
    removed = []

    def remove(path, missing_ok=False):
        if recording in path.parents or path == recording:
            if len(removed) == killed_after:
                raise KeyboardInterrupt
            removed.append(path)
        (os.rmdir if path.is_dir() else os.unlink)(path)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", remove)
        patched.setattr(Path, "rmdir", remove)
        with pytest.raises(KeyboardInterrupt):
            overwrite(recording, model_file())
    assert recording.is_dir()
    overwrite(recording, model_file())
    assert read_recording(recording).frames == ()
