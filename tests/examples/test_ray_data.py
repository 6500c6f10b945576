"""Answers of a local Ray of two processors: those of a plain run, also where an actor is killed."""

import os

import cv2
import numpy as np
from typer.testing import CliRunner

from runtime.heads import HEADS
from runtime.io.encode import ENCODERS
from runtime.predictor import Predictor
from runtime.run.cli import app
from runtime.sources.bundled_stream import bundled_frames, bundled_stream
from runtime.sources.registry import choose_source

COLUMNS = {"index", "name", "reason", "degraded"}


def folders_of(rgb, depth):
    return choose_source("folders", rgb, depth=depth)


def rows_of(dataset):
    return sorted(dataset.iter_rows(), key=lambda row: row["index"])


def test_rows_are_the_files_of_a_plain_run(predict_source, tmp_path):
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
    assert [bool(row["reason"]) for row in rows] == [number == 3 for number in range(len(rows))]
    heads = {"semantic", "depth", "boundary", "depth_uncertainty"}
    for row in rows:
        assert row.keys() == {*COLUMNS, *heads}
        if row["reason"]:
            assert "damaged" in row["reason"]
            assert all(row[head].size == 0 for head in heads)
            continue
        for head in heads:
            expected = (out / HEADS[head].saved_as / f"{row['name']}.png").read_bytes()
            assert ENCODERS[HEADS[head].unit](row[head]) == expected


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


def test_a_killed_actor_loses_no_frame(predict_source, tmp_path):
    import psutil

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
    for row in predict_source(folders_of(*folders)).iter_rows():
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
