"""Answers of a local Ray of two processors: those of a plain run, also where an actor is killed."""

import os

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime.errors import ContractError, InputError
from runtime.heads import HEADS
from runtime.io.encode import ENCODERS
from runtime.predictor import Predictor
from runtime.run.cli import app
from runtime.sources.bundled_stream import bundled_frames, bundled_stream
from runtime.sources.registry import choose_source

COLUMNS = {
    *("index", "name", "status", "reason", "degraded", "latency_ms"),
    *("image_stamp_ns", "depth_stamp_ns"),
}


def folders_of(rgb, depth):
    return choose_source(f"folders:{rgb}", depth=depth)


def rows_of(dataset):
    return sorted(dataset.iter_rows(), key=lambda row: row["index"])


def test_rows_are_the_files_of_a_plain_run(cluster, tmp_path):
    from runtime.run.ray_data import predict_source

    frames = bundled_frames()
    folders = tmp_path / "rgb", tmp_path / "depth"
    for folder in folders:
        folder.mkdir()
    for number, frame in enumerate(frames):
        columns = slice(0, 160 if number % 2 else 192)  # two sizes
        rgb, depth = frame.rgb[:96, columns], frame.sparse_depth[-96:, columns]
        cv2.imwrite(str(folders[0] / f"{number}.png"), rgb[..., ::-1])
        cv2.imwrite(str(folders[1] / f"{number}.png"), np.rint(depth * 256).astype(np.uint16))
    (folders[0] / "3.png").write_bytes(b"damaged")
    out = tmp_path / "out"
    result = CliRunner().invoke(
        app,
        ["--rgb", folders[0], "--depth", folders[1], "--out", out, "--threads", "1"],
    )
    assert result.exit_code == 3, result.output
    rows = rows_of(predict_source(folders_of(*folders), actors=2))
    assert [row["name"] for row in rows] == [str(number) for number in range(len(frames))]
    assert [row["status"] for row in rows] == ["ok"] * 3 + ["skipped"] + ["ok"] * (len(rows) - 4)
    heads = {"semantic", "depth", "boundary", "depth_uncertainty"}
    for row in rows:
        assert row.keys() == {*COLUMNS, *heads}
        if row["status"] != "ok":
            assert "damaged" in row["reason"]
            assert all(row[head].size == 0 for head in heads)
            continue
        assert row["latency_ms"] > 0
        assert row["image_stamp_ns"] is row["depth_stamp_ns"] is None
        for head in heads:
            expected = (out / HEADS[head].saved_as / f"{row['name']}.png").read_bytes()
            assert ENCODERS[HEADS[head].encoding](row[head]) == expected


def actor_processes():
    """Of the cluster that this process started."""
    import psutil

    found = []
    for process in psutil.process_iter(["cmdline"]):
        if any("MapWorker" in word for word in process.info["cmdline"] or ()) and any(
            parent.pid == os.getpid() for parent in process.parents()
        ):
            found.append(process)
    return found


def test_a_killed_actor_loses_no_frame(cluster, tmp_path):
    import psutil

    from runtime.run.ray_data import predict_source

    frames = bundled_frames()
    folders = tmp_path / "rgb", tmp_path / "depth"
    for folder, original in zip(folders, bundled_stream(), strict=True):
        folder.mkdir()
        files = sorted(original.iterdir())
        for number in range(3 * len(frames)):  # seconds of work
            path = files[number % len(files)]
            (folder / f"{number}{path.suffix}").symlink_to(path)
    psutil.wait_procs(actor_processes(), timeout=60)  # those of other tests
    rows, killed, seen = [], [], set()
    for row in predict_source(folders_of(*folders), heads=["semantic"]).iter_rows():
        rows.append(row)
        if not killed:  # at the first row: the actor has just begun
            (actor,) = actor_processes()
            actor.kill()
            killed.append(actor.pid)
        seen.update(process.pid for process in actor_processes())
    assert seen - set(killed), "another has taken over"
    assert sorted(row["index"] for row in rows) == list(range(3 * len(frames)))
    with Predictor(threads=1) as predictor:
        for number, frame in enumerate(frames):
            expected = predictor.predict(frame.rgb, frame.sparse_depth).semantic
            for row in rows:
                if row["index"] % len(frames) == number:
                    np.testing.assert_array_equal(row["semantic"], expected, strict=True)


def test_what_cannot_run_is_reported_before_anything_starts(cluster, tmp_path):
    from runtime.run.ray_data import predict_source

    with pytest.raises(InputError, match="cannot list the folder"):
        predict_source(folders_of(tmp_path / "none", tmp_path))
    with pytest.raises(ContractError, match="no bundled model"):
        predict_source(folders_of(*bundled_stream()), model="unknown")
    with pytest.raises(ContractError, match="SHA-256"):
        predict_source(folders_of(*bundled_stream()), sha256="0" * 64)
    with pytest.raises(InputError, match="cuda needs gpus="):
        predict_source(folders_of(*bundled_stream()), provider="cuda")
    with pytest.raises(InputError, match="actors must be"):
        predict_source(folders_of(*bundled_stream()), actors=0)


def test_an_actor_that_cannot_start_reports_why(cluster):
    from runtime.run.ray_data import predict_source

    with pytest.raises(cluster.exceptions.RayError, match="heads asks for colour, the model"):
        list(predict_source(folders_of(*bundled_stream()), heads=["colour"]).iter_rows())
