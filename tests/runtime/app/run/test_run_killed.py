"""ssdnet-run killed at any moment, with every output: what has its name is whole."""

import importlib.util
import json
import random
import signal
import sys
import time

import cv2
import pytest

from cli_runs import COMMAND, N, rows_of
from runtime.app.run.options import SUFFIXES
from runtime.verification.reference import read_reference

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals"),
]
KILLS = 4


def frames_of_video(path):
    file, frames = cv2.VideoCapture(str(path)), 0
    while file.read()[0]:
        frames += 1
    return frames


def frames_of_mcap(path):
    from rosbags.rosbag2 import Reader

    with Reader(path) as reader:
        (overlays,) = [c for c in reader.connections if c.topic.endswith("overlay/compressed")]
        return overlays.msgcount


# Name or suffix of an output -> the frames that it holds; fails where it is damaged.
FRAMES = {
    "run.mp4": frames_of_video,
    "run.mcap": frames_of_mcap,
    "run.html": lambda path: N * path.read_text().endswith("</html>\n"),
    "frames.csv": lambda path: len(rows_of(path.parent)),
    "report.json": lambda path: json.loads(path.read_text())["frames"]["by_status"]["ok"],
    "reference.json": lambda path: len(read_reference(path.parent).frames),
}


def require_whole(folder):
    """Check all that has its name: hidden are only what is not done, and a folder's list."""
    seen = set()
    for path in folder.rglob("*"):
        parts = path.relative_to(folder).parts
        if hidden := [part for part in parts if part.startswith(".")]:
            assert hidden[0].endswith(".part") or hidden == [".ssdnet"], path
        elif path.name in FRAMES:
            assert FRAMES[path.name](path) == N, path
            seen.add(path.name)
        elif parts[0] == "out" and path.suffix in (".png", ".jpg"):
            assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED) is not None, path
        elif path.suffix == ".ply":
            header, content = path.read_bytes().split(b"end_header\n", 1)
            (count,) = [int(line.split()[2]) for line in header.splitlines() if b"vertex" in line]
            assert len(content) == 20 * count > 0, path
    return seen


def test_what_has_its_name_is_whole(tmp_path, make_stream, all_heads, start_process):
    rgb, depth = make_stream(N)
    files = {"--video": "run.mp4", "--page": "run.html", "--record": "recording"}
    if importlib.util.find_spec("rosbags"):
        files["--mcap"] = "run.mcap"
    command = [sys.executable, "-c", COMMAND, "--rgb", rgb, "--depth", depth, "--model", all_heads]
    command += ["--out", tmp_path / "out", "--save", ",".join(SUFFIXES), "--focal-length", 60]
    command += [word for option, name in files.items() for word in (option, tmp_path / name)]

    def run(kill_after_s=None):
        """Run, killed so long after its first line; returns the time from then on."""
        process = start_process(*command, "--overwrite")
        process.stdout.readline()
        started = time.monotonic()
        if kill_after_s is None:
            assert process.wait(60) == 0
        else:
            time.sleep(kill_after_s)
            process.kill()
            killed.append(process.wait(60) == -signal.SIGKILL)
        return time.monotonic() - started

    killed = []
    whole_s = run()
    everything = require_whole(tmp_path)
    assert everything >= FRAMES.keys() - {"run.mcap"}
    for _ in range(KILLS):
        run(random.uniform(0, 0.8) * whole_s)
        require_whole(tmp_path)
    assert any(killed)
    run()
    assert require_whole(tmp_path) == everything, "a killed run is replaced"
    assert not list(tmp_path.rglob("*.part")), "and what it left is cleared away"
    assert {len(list((tmp_path / "out" / kind).iterdir())) for kind in SUFFIXES} == {N}
