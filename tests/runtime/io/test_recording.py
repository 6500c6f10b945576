"""A recording comes back as it was written, whole or not at all, and damage is told."""

import io
import json
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
    assert read.limits == {"depth": pytest.approx(5e-5 * contract.max_depth_m)}
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
    with pytest.raises(OutputError, match="no recording"), record(others, SETTINGS, overwrite=True):
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
        {"version": "2.0"},
        {"settings": {"size": None}},
        {"settings": []},
        {"model": None},
        {"limits": {"speed": 1}},
        {"limits": None},
        {"limits": {"depth": 10**400}},
        {"limits": {"depth": "1"}},
        {"limits": {"depth": float("nan")}},
        {"limits": {"depth": -1}},
        {"frames": [{"name": "x"}]},
        {"frames": 7},
        {"frames": [{"name": "x", "valid": True, "degraded": 3, "predict_ms": 1}]},
    ],
    ids=str,
)
def test_a_document_that_was_changed_is_refused(recording, changes):
    edit(recording, **changes)
    with pytest.raises(InputError, match="is not the document of a recording"):
        read_recording(recording)


@pytest.mark.parametrize(("content", "told"), [(b"{", "not JSON"), (None, "cannot read")])
def test_a_folder_that_is_no_recording_is_refused(recording, content, told):
    path = recording / "recording.json"
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=told):
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


def test_a_small_file_that_unpacks_to_gigabytes_is_refused(recording, make_frame, monkeypatch):
    rgb, depth = make_frame()
    bomb = recording / "frames" / "000000.npz"
    np.savez_compressed(bomb, rgb=rgb, sparse_depth=depth, depth=np.zeros(2**20, np.uint8))
    assert bomb.stat().st_size < 2**16
    read = read_recording(recording)
    monkeypatch.setattr("runtime.io.recording.MAX_FRAME_BYTES", 2**20)
    monkeypatch.setattr(np, "load", None)  # not even opened
    with pytest.raises(InputError, match="bytes in a frame, at most 1,048,576"):
        read.arrays(0)


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
    with pytest.raises(OutputError, match=r"(thesis|mine|000002|deep)[.a-z]* is not of the"):
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
    with pytest.raises(OutputError, match="no recording"):
        overwrite(folder, model_file())
    assert (folder / "recording.json").read_text() == content


def test_a_link_to_a_recording_is_not_replaced(recording, tmp_path, model_file):
    (tmp_path / "link").symlink_to(recording)
    with pytest.raises(OutputError, match="no recording"):
        overwrite(tmp_path / "link", model_file())
    assert len(read_recording(recording).frames) == 2


def test_a_name_that_is_too_long_is_an_output_error(tmp_path, model_file):
    with pytest.raises(OutputError, match="too long"):
        overwrite(tmp_path / ("n" * 256), model_file())
