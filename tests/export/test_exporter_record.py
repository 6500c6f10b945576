"""ssdnet-export --record: what PyTorch answers is verified by the engine alone."""

import shutil

import numpy as np
import onnx
import pytest
from typer.testing import CliRunner

from export import build, exporter
from export.errors import ExportError
from runtime.app.tools.verify import app as verify_app
from runtime.verification.reference import read_reference

SIZE = (64, 96)


def test_the_recording_holds_pytorchs_answers_and_the_file(exported, beside):
    recording = read_reference(beside / "recording")
    assert recording.settings.provider == "torch"
    assert recording.settings.made_by == "ssdnet-export"
    assert recording.model.read_bytes() == exported.path.read_bytes()
    assert recording.limits.keys() == {"semantic", "depth", "boundary", "depth_uncertainty"}
    assert [frame.name for frame in recording.frames][:2] == [
        "scan lines 0, 64 x 96",
        "scan lines 1, 64 x 96",
    ]
    assert len(recording.frames) == exported.num_frames


def test_the_engine_verifies_it(exported, beside, tmp_path):
    result = CliRunner().invoke(verify_app, [str(beside / "recording")])
    assert result.exit_code == 0, result.output
    copy = tmp_path / "copy"
    shutil.copytree(beside / "recording", copy)
    path = copy / "frames" / "000003.npz"
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, "depth": arrays["depth"] + np.float32(0.01)})
    result = CliRunner().invoke(verify_app, [str(copy)])
    assert result.exit_code == 4
    assert any(
        line.startswith("depth ") and line.endswith("full, 64 x 96")
        for line in result.output.splitlines()
    ), result.output


def test_an_export_that_fails_leaves_nothing(lite_checkpoint, tmp_path, monkeypatch):
    def fail(model, path, frames, *, dynamic):
        assert [entry.suffix for entry in tmp_path.iterdir()] == [".part", ".part"]
        raise ExportError("differs")

    monkeypatch.setattr(build, "trace", lambda *args, **options: onnx.ModelProto(ir_version=10))
    monkeypatch.setattr(exporter, "measure_parity", fail)
    with pytest.raises(ExportError, match="differs"):
        exporter.export_checkpoint(
            lite_checkpoint,
            tmp_path / "lite.onnx",
            size=SIZE,
            record_dir=tmp_path / "recording",
            triton_dir=tmp_path / "triton",
        )
    assert list(tmp_path.iterdir()) == []
