"""A recording comes back as it was written, whole or not at all, and damage is reported."""

import json
from pathlib import Path

import numpy as np
import pytest

from runtime import ContractError, InputError
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    read_reference,
    write_reference,
)

SETTINGS = PredictorSettings("the-test", size=(48, 64), focal_length_px=300.0)


@pytest.fixture
def recording(tmp_path, model_file, make_frame) -> Path:
    folder = tmp_path / "recording"
    with write_reference(folder, SETTINGS) as recorder:
        for index in range(2):
            rgb, depth = make_frame(seed=index)
            frame = ReferenceFrame(f"frame {index}", index == 0, ("no_depth",), 12.5)
            recorder.add(frame, rgb, depth, {"depth": depth + 1})
        recorder.finish(model_file())
    return folder


def test_what_was_recorded_comes_back(recording, model_file, make_frame, contract):
    read = read_reference(recording)
    assert read.settings == SETTINGS
    assert read.model.read_bytes() == model_file("again.onnx").read_bytes()
    assert read.model_name == contract.model_name
    assert read.limits == {"depth": {"max_abs_m": pytest.approx(5e-5 * contract.max_depth_m)}}
    assert read.frames[0] == ReferenceFrame("frame 0", True, ("no_depth",), 12.5)
    assert read.software.keys() == {"ssdnet", "onnxruntime", "system"}
    rgb, depth = make_frame(seed=0)
    arrays = read.arrays(0)
    np.testing.assert_array_equal(arrays["rgb"], rgb)
    np.testing.assert_array_equal(arrays["sparse_depth"], depth)
    np.testing.assert_array_equal(arrays["depth"], depth + 1)
    assert read.arrays(1).keys() == {"rgb", "sparse_depth"}, "an invalid answer is not kept"
    size = (recording / "frames" / "000000.npz").stat().st_size
    assert size < 0.8 * sum(array.nbytes for array in arrays.values()), "it is compressed"


def test_one_without_its_software_is_read_like_a_new_one(recording):
    document = json.loads((recording / "reference.json").read_text())
    del document["software"]
    (recording / "reference.json").unlink()
    (recording / "recording.json").write_text(json.dumps({**document, "version": "2.0"}))
    assert read_reference(recording).software == {}


def test_a_model_that_was_replaced_meanwhile_is_refused(tmp_path, model_file):
    with (
        pytest.raises(ContractError, match="expected"),
        write_reference(tmp_path / "r", SETTINGS) as r,
    ):
        r.finish(model_file(), sha256="0" * 64)


def edit(folder, **changes):
    path = folder / "reference.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize("changes", [
    {"format": "another"}, {"version": "1.0"}, {"settings": []}, {"limits": {"depth": {}}},
    {"limits": {"depth": {"agreement": 1}}}, {"limits": {"depth": {"max_abs_m": float("nan")}}},
    {"limits": {"speed": {"max_abs": 1}}}, {"frames": [{"name": "x"}]},
], ids=str)  # fmt: skip
def test_a_document_that_was_changed_is_refused(recording, changes):
    edit(recording, **changes)
    with pytest.raises(InputError, match="is not a valid reference"):
        read_reference(recording)


@pytest.mark.parametrize(("content", "message"), [(b"{", "not a valid"), (None, "cannot read")])
def test_a_folder_that_is_no_recording_is_refused(recording, content, message):
    path = recording / "reference.json"
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_reference(recording)


def test_a_frame_with_other_arrays_or_cut_is_refused(recording, make_frame):
    path = recording / "frames" / "000000.npz"
    read, whole = read_reference(recording), path.read_bytes()
    for content in (whole[: len(whole) // 2], b""):
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            read.arrays(0)
    rgb, depth = make_frame()
    np.savez(path, rgb=rgb, sparse_depth=depth)
    with pytest.raises(InputError, match=r"expected .*'depth'"):
        read.arrays(0)


def test_the_older_one_stays_until_the_new_one_is_whole(recording, model_file, monkeypatch):
    def overwrite():
        with write_reference(recording, SETTINGS, overwrite=True) as recorder:
            recorder.finish(model_file())

    def kill(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", kill)
        with pytest.raises(KeyboardInterrupt):
            overwrite()
    assert len(read_reference(recording).frames) == 2
    overwrite()
    assert read_reference(recording).frames == ()
