"""A recording comes back as it was written, whole or not at all, and damage is reported."""

import io
import json
import os
import pickle
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
        pytest.raises(OutputError, match="did not write"),
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
        {"settings": []},
        {"model": None},
        {"limits": {"depth": {}}},
        {"limits": {"depth": {"agreement": 1}}},
        {"limits": {"depth": {"max_abs_m": float("nan")}}},
        {"limits": {"speed": {"max_abs": 1}}},
        {"frames": [{"name": "x"}]},
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


def pack(path, compression=zipfile.ZIP_STORED, **contents):
    """Write members as they are: (name without .npy) -> bytes or an array."""
    with zipfile.ZipFile(path, "w", compression) as packed:
        for name, content in contents.items():
            if isinstance(content, np.ndarray):
                stream = io.BytesIO()
                np.save(stream, content)
                content = stream.getvalue()
            packed.writestr(f"{name}.npy", content)


def test_a_frame_that_is_compressed_is_refused(recording, make_frame):
    """A small file could unpack to gigabytes; recordings are never compressed."""
    rgb, depth = make_frame()
    path = recording / "frames" / "000000.npz"
    pack(path, zipfile.ZIP_DEFLATED, rgb=rgb, sparse_depth=depth, depth=depth)
    with pytest.raises(InputError, match="its arrays are compressed"):
        read_recording(recording).arrays(0)


def header(text):
    """An array of 16 bytes with this header."""
    text = text.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(16)


TAMPERED = {
    "bytes": b"no array",
    "no header": b"\x93NUMPY\x01\x00\xff\xff",
    "tokens": header("{'descr': '<f4', 'fortran_order': False, 'shape': (4,"),
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


def test_a_frame_with_other_arrays_or_cut_is_refused(recording, make_frame):
    path = recording / "frames" / "000000.npz"
    read, whole = read_recording(recording), path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"PK\x03\x04", pickle.dumps({"rgb": 1})):
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            read.arrays(0)
    rgb, depth = make_frame()
    np.savez(path, rgb=rgb, sparse_depth=depth)
    with pytest.raises(InputError, match=r"expected .*'depth'"):
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


def overwrite(recording, model):
    with record(recording, SETTINGS, overwrite=True) as recorder:
        recorder.finish(model)


@pytest.mark.parametrize("name", ["thesis.txt", "frames/000002.npz", "deep/x"])
def test_a_recording_with_a_foreign_file_is_not_replaced(recording, model_file, name):
    (recording / name).parent.mkdir(exist_ok=True)
    (recording / name).write_text("mine")
    before = {path: path.read_bytes() for path in recording.rglob("*") if path.is_file()}
    with pytest.raises(OutputError, match="does not belong to the"):
        overwrite(recording, model_file())
    assert before == {path: path.read_bytes() for path in recording.rglob("*") if path.is_file()}


@pytest.mark.parametrize("killed_after", [1, 3, 5])
def test_a_removal_that_was_killed_is_finished_by_the_next(
    recording, model_file, monkeypatch, killed_after
):
    """The rest of the older recording is still known for what it is, and replaced."""
    removed = []

    def remove(path, missing_ok=False):
        if recording in path.parents or path == recording:
            removed.append(path)
            if len(removed) > killed_after:
                raise KeyboardInterrupt
        (os.rmdir if path.is_dir() else os.unlink)(path)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", remove)
        patched.setattr(Path, "rmdir", remove)
        with pytest.raises(KeyboardInterrupt):
            overwrite(recording, model_file())
    overwrite(recording, model_file())
    assert read_recording(recording).frames == ()
