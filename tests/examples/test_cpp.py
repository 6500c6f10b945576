"""The C++ example gives the answers of the engine; damaged inputs are errors, never a crash."""

import dataclasses
import json
import os
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.contract.model_file import load_model_file, with_contract
from runtime.contract.resize import move_returns
from runtime.engine.bundled_models import list_bundled_models
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    read_reference,
    write_reference,
)
from runtime.verification.unpack import unpack

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "examples" / "cpp"
INCLUDE = os.environ.get("SSDNET_ORT_INCLUDE")


@pytest.fixture(scope="module")
def library():
    """ONNX Runtime's library in the wheel that is installed."""
    if not INCLUDE:
        pytest.skip("SSDNET_ORT_INCLUDE, the folder of ONNX Runtime's headers, is not set")
    missing = [program for program in ("cmake", "g++") if shutil.which(program) is None]
    assert not missing, f"{' and '.join(missing)} not installed"
    import onnxruntime

    (found,) = (Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so.*")
    return found


def run(*command, **environment):
    done = subprocess.run(
        [*map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | environment,
    )
    return done.returncode, done.stdout + done.stderr


def build(folder, library, *options):
    places = f"-DONNXRUNTIME_LIBRARY={library}", f"-DSSDNET_ORT_INCLUDE={INCLUDE}"
    code, printed = run("cmake", "-S", EXAMPLE, "-B", folder, *places, *options)
    assert code == 0, printed
    return folder


@pytest.fixture(scope="module")
def built(library, tmp_path_factory):
    folder = build(tmp_path_factory.mktemp("built"), library)
    code, printed = run("cmake", "--build", folder, "--parallel", "2")
    assert code == 0, printed
    return folder


@pytest.fixture(scope="module")
def checked(library, tmp_path_factory):
    """The program that finds its own memory faults and undefined behaviour."""
    # Without optimisation: it compiles in half the time, and no fault is optimised away.
    flags = "-O0 -fsanitize=address,undefined -fno-sanitize-recover=all"
    folder = tmp_path_factory.mktemp("checked")
    build(folder, library, "-DCMAKE_BUILD_TYPE=None", f"-DCMAKE_CXX_FLAGS={flags}")
    code, printed = run("cmake", "--build", folder, "--target", "verify")
    assert code == 0, printed
    return folder / "verify"


def unpacked(folder, model, rgb, depth, focal_length_px=None):
    """The files that ssdnet-verify --unpack writes for a frame."""
    with Predictor(model, threads=1, warmup=0, focal_length_px=focal_length_px) as predictor:
        with write_reference(
            folder / "recording", PredictorSettings("test", None, focal_length_px)
        ) as recorder:
            answer = predictor.predict(rgb, depth)
            frame = ReferenceFrame("frame", answer.valid, answer.degraded)
            recorder.add(frame, rgb, depth, answer.heads)
            recorder.finish(predictor.model.path)
        unpack(read_reference(folder / "recording"), predictor, folder / "plain")
    return folder / "plain"


def figures(printed):
    """Read lines like "depth max_abs_m 0, limit 0.005": head -> value."""
    lines = [line.split() for line in printed.splitlines() if ", limit " in line]
    return {head: float(value.rstrip(",")) for head, _, value, *_ in lines}


@pytest.mark.parametrize("name", list_bundled_models())
def test_the_answers_are_the_engines_to_the_bit(built, tmp_path, name):
    frame = bundled_frames()[0]
    plain = unpacked(tmp_path, name, frame.rgb, frame.sparse_depth, BUNDLED_FOCAL_LENGTH_PX)
    code, printed = run(built / "verify", plain, 1)
    assert code == 0, printed
    found = figures(printed)
    assert found.pop("semantic") == 1
    assert found == {"depth": 0, "boundary": 0, "depth_uncertainty": 0}
    values = np.load(plain / "000000" / "depth.npy")
    np.save(plain / "000000" / "depth.npy", values * np.float32(1.1))
    code, printed = run(built / "verify", plain, 1)
    assert code == 4, printed


def test_a_camera_of_1080_rows(built, tmp_path):
    """Resized, returns moved, and the depth moved to the returns of the frame's own size."""
    frame, size = bundled_frames()[0], (1080, 1920)
    rgb = cv2.resize(frame.rgb, size[::-1], interpolation=cv2.INTER_CUBIC)
    depth = move_returns(frame.sparse_depth, size)
    plain = unpacked(tmp_path, "ssdnet-nano", rgb, depth, 1100.0)
    code, printed = run(built / "verify", plain, 1)
    assert code == 0, printed
    found = figures(printed)
    assert found["semantic"] == 1
    assert found["boundary"] == 0
    assert max(found["depth"], found["depth_uncertainty"]) < 1e-3


def test_the_loop_answers_in_time_or_counts_what_is_late(built, model_file):
    code, printed = run(built / "loop", model_file(heads=("semantic", "depth")))
    assert code == 0, printed
    assert "m ahead" in printed
    counts = [int(word) for word in printed.splitlines()[-1].split() if word.isdecimal()]
    assert sum(counts) == 20


def test_what_is_installed_runs_elsewhere(built, tmp_path):
    code, printed = run("cmake", "--install", built, "--prefix", tmp_path)
    assert code == 0, printed
    headers = {path.name for path in EXAMPLE.glob("*.hpp")}
    assert {path.name for path in (tmp_path / "include").iterdir()} == headers
    for program in ("verify", "loop"):  # the library is found before the arguments are missed
        _, printed = run(tmp_path / "bin" / program)
        assert "usage: " in printed


def edit(name, old, new):
    def spoil(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return spoil


def cut(name, share):
    def spoil(folder):
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(share * len(content))])

    return spoil


def array(name, values):
    return lambda folder: np.save(folder / "000000" / name, values)


def metadata(**changes):
    """The model with other metadata, whose digests are right."""

    def spoil(folder):
        path = folder / "model.onnx"
        contract = load_model_file(path).contract
        content = path.read_bytes()[: contract.content.bytes]
        path.write_bytes(with_contract(content, dataclasses.replace(contract, **changes)))

    return spoil


def manifest(key, value):
    def spoil(folder):
        document = json.loads((folder / "manifest.json").read_text())
        document["frames"][0][key] = value
        (folder / "manifest.json").write_text(json.dumps(document))

    return spoil


DAMAGED = {
    "no model": lambda folder: (folder / "model.onnx").unlink(),
    "an empty model": cut("model.onnx", 0),
    "half a model": cut("model.onnx", 0.5),
    "a model without the end": cut("model.onnx", 0.99),
    "a model that is text": lambda folder: (folder / "model.onnx").write_text("model" * 99),
    "another schema": metadata(schema_version="1.3"),
    "a range of a million kilometres": metadata(max_depth_m=1e9),
    "a focal length of 0": metadata(canonical_focal_px=0.0),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "half a manifest": cut("manifest.json", 0.5),
    "lists without an end": lambda folder: (folder / "manifest.json").write_text("[" * 99999),
    "another format": edit("manifest.json", "ssdnet-unpacked", "ssdnet-packed"),
    "another version": edit("manifest.json", '"1.0"', '"9.0"'),
    "an unknown figure": edit("manifest.json", "max_abs_m", "max_abs_ft"),
    "a focal length of NaN": manifest("focal_length_px", float("nan")),
    "a negative focal length": manifest("focal_length_px", -5),
    "a size of one number": manifest("network_size", [48]),
    "a size of no pixels": manifest("network_size", [-1, 64]),
    "a size beyond memory": manifest("network_size", [16384, 16384]),
    "half an image": cut("000000/rgb.npy", 0.5),
    "a header alone": cut("000000/sparse_depth.npy", 0.001),
    "an image of floats": array("rgb.npy", np.ones((48, 64, 3), np.float32)),
    "an empty image": array("rgb.npy", np.ones((0, 0, 3), np.uint8)),
    "a tiny image": array("rgb.npy", np.ones((8, 8, 3), np.uint8)),
    "depth of another size": array("sparse_depth.npy", np.ones((40, 64), np.float32)),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_inputs_are_errors(checked, model_file, make_frame, tmp_path, case):
    model = model_file(heads=("semantic", "depth", "boundary", "depth_uncertainty"))
    plain = unpacked(tmp_path, model, *make_frame(48, 64))
    DAMAGED[case](plain)
    code, printed = run(checked, plain, 1, ASAN_OPTIONS="detect_leaks=0")
    assert code == 1, printed
    assert printed.startswith("error: "), printed
    assert "Sanitizer" not in printed


@pytest.mark.parametrize("size", [(48, 64), (333, 401)])
def test_nothing_is_read_or_written_outside(
    checked, model_file, make_frame, contract, tmp_path, size
):
    contract = dataclasses.replace(contract, trained_height=40, canonical_focal_px=700.0)
    model = model_file(heads=("semantic", "depth", "boundary"), contract=contract)
    rgb, depth = make_frame(*size)
    depth[0, :6] = np.nan, np.inf, -1, 80, 200, 65.535
    code, printed = run(
        checked, unpacked(tmp_path, model, rgb, depth, 350.0), 1, ASAN_OPTIONS="detect_leaks=0"
    )
    assert code == 0, printed
