"""Answers of a local Ray are those of a plain run, also where an actor is killed."""

import importlib.util
import os
import secrets
import sys
from pathlib import Path

import cv2
import numpy as np
import psutil
import pytest
from typer.testing import CliRunner

from runtime.app.run.cli import app
from runtime.contract.heads import HEADS
from runtime.drawing.encode import ENCODERS
from runtime.recordings.bundled_stream import bundled_frames
from runtime.recordings.registry import choose_source

EXAMPLE = Path(__file__).parents[2] / "examples" / "ray_data.py"
COUNT, DAMAGED = 30, 3


@pytest.fixture
def predict_source(monkeypatch):
    """The function of the example, with a Ray of its own that reports to nobody."""
    if importlib.util.find_spec("ray") is None:
        pytest.skip("the extra ray is not installed")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
    monkeypatch.setenv("RAY_worker_niceness", "0")  # by default others go first
    import ray

    local = {"address": "local", "num_cpus": 2, "object_store_memory": 128 << 20}
    ray.init(**local, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    spec = importlib.util.spec_from_file_location("ray_data_example", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    ray.cloudpickle.register_pickle_by_value(module)  # the workers cannot import it
    yield module.predict_source
    ray.cloudpickle.unregister_pickle_by_value(module)
    ray.shutdown()


def kill_an_actor():
    """Kill one of the processes that predict."""
    for process in psutil.Process(os.getpid()).children(recursive=True):
        if any("MapWorker" in word for word in process.cmdline()):
            process.kill()
            return
    raise AssertionError("no actor is running")


def test_rows_are_the_files_of_a_plain_run_also_where_an_actor_dies(predict_source, tmp_path):
    folders, frames = (tmp_path / "rgb", tmp_path / "depth"), bundled_frames()
    for folder in folders:
        folder.mkdir()
    for number in range(COUNT):
        frame = frames[number % len(frames)]
        columns = slice(0, 160 if number % 2 else 192)  # two sizes
        rgb, depth = frame.rgb[:96, columns], frame.sparse_depth[-96:, columns]
        cv2.imwrite(str(folders[0] / f"{number:02d}.png"), rgb[..., ::-1])
        cv2.imwrite(str(folders[1] / f"{number:02d}.png"), np.rint(depth * 256).astype(np.uint16))
    (folders[0] / f"{DAMAGED:02d}.png").write_bytes(b"damaged")
    out = tmp_path / "out"
    arguments = ["--rgb", folders[0], "--depth", folders[1], "--out", out, "--threads", "1"]
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == 3, result.output

    log, rows = choose_source("folders", folders[0], depth=folders[1]), []
    for row in predict_source(log, actors=2).iter_rows():
        if not rows:  # the actors have just begun
            kill_an_actor()
        rows.append(row)
    rows.sort(key=lambda row: row["index"])
    assert [row["index"] for row in rows] == list(range(COUNT))
    assert [row["index"] for row in rows if row["reason"]] == [DAMAGED]
    heads = {"semantic", "depth", "boundary", "depth_uncertainty"}
    for row in rows:
        assert row.keys() == {"index", "name", "reason", "degraded", *heads}
        for head in heads:
            if row["reason"]:
                assert row[head].size == 0
                continue
            expected = (out / HEADS[head].saved_as / f"{row['name']}.png").read_bytes()
            assert ENCODERS[HEADS[head].unit](row[head]) == expected
