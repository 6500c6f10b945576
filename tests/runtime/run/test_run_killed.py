"""ssdnet-run killed at any moment, with every output: what has its name is whole."""

import csv
import importlib.util
import json
import random
import signal
import subprocess
import sys
import time

import cv2
import pytest

from runtime.io.recording import read_recording
from runtime.run.options import KINDS, SUFFIXES

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals"),
]

N = 12
KILLS = 8
# Forks a process a line, which runs the command with the line's arguments: little but the run
# takes time then. (ONNX Runtime does not stand a fork after its import.)
SERVER = """
import json, os, signal, sys, time
import cv2
import runtime.run.cli
print("ready", flush=True)
for line in sys.stdin:
    arguments, kill_after_s = json.loads(line)
    if (child := os.fork()) == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.argv = ["ssdnet-run", *arguments]
        runtime.run.cli.app()
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        os.kill(child, signal.SIGKILL)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture
def server():
    """Run the command with these arguments, kill it after so many seconds; its exit code."""
    process = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"

    def run(arguments, kill_after_s=None):
        asked = [[str(argument) for argument in arguments], kill_after_s]
        process.stdin.write(json.dumps(asked) + "\n")
        process.stdin.flush()
        return int(process.stdout.readline())

    yield run
    process.stdin.close()
    process.wait(20)


@pytest.fixture
def arguments(tmp_path, make_stream, all_heads):
    """A run of N frames with every output that can be written here."""
    rgb, depth = make_stream(N)
    options = {
        "--rgb": rgb,
        "--depth": depth,
        "--model": all_heads,
        "--out": tmp_path / "out",
        "--save": ",".join(SUFFIXES),
        "--focal-length": 60,
        "--threads": 1,
        "--warmup": 0,
        "--video": tmp_path / "run.mp4",
        "--report": tmp_path / "run.html",
        "--record": tmp_path / "recording",
    }
    if importlib.util.find_spec("rosbags"):
        options["--mcap"] = tmp_path / "run.mcap"
    return [text for option in options.items() for text in option]


def frames_of_video(path):
    file = cv2.VideoCapture(str(path))
    frames = 0
    while file.read()[0]:
        frames += 1
    assert frames == int(file.get(cv2.CAP_PROP_FRAME_COUNT))
    return frames


def read_ply_points(path):
    header, content = path.read_bytes().split(b"end_header\n", 1)
    (count,) = [int(line.split()[2]) for line in header.splitlines() if b"element vertex" in line]
    assert len(content) == count * 16
    return count


def require_whole(folder, read_mcap_frames):
    """Check all that has its name; hidden are only what is not done, and the folder's marker."""
    seen = set()
    for path in folder.rglob("*"):
        hidden = [part for part in path.relative_to(folder).parts if part.startswith(".")]
        if hidden:
            assert hidden[0].endswith(".part") or hidden == [".ssdnet"], path
            continue
        if path.is_dir() or path.parent.name in ("cam", "lidar", "frames"):
            continue
        seen.add(path.name if path.parent.name in ("out", folder.name) else path.parent.name)
        if path.suffix in (".png", ".jpg"):
            assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED) is not None, path
        elif path.suffix == ".ply":
            assert read_ply_points(path) > 0
        elif path.suffix == ".mp4":
            assert frames_of_video(path) == N
        elif path.suffix == ".html":
            assert path.read_text().endswith("</html>\n")
        elif path.suffix == ".mcap":
            assert read_mcap_frames(path) == N
        elif path.name == "frames.csv":
            with path.open() as file:
                assert len(list(csv.DictReader(file))) == N
        elif path.name == "report.json":
            assert json.loads(path.read_text())["frames"]["by_status"] == {"ok": N}
        elif path.parent.name == "recording":
            assert len(read_recording(path.parent).frames) == N
        else:
            assert path.suffix == ".onnx", path
    return seen


@pytest.fixture
def read_mcap_frames():
    """How many frames an MCAP file has answers of."""

    def count(path):
        from rosbags.rosbag2 import Reader

        with Reader(path) as reader:
            (overlays,) = [c for c in reader.connections if c.topic.endswith("compressed")]
            return overlays.msgcount

    return count


def test_what_has_its_name_is_whole(tmp_path, server, arguments, read_mcap_frames):
    started = time.monotonic()
    assert server(arguments) == 0
    whole_s = time.monotonic() - started
    everything = require_whole(tmp_path, read_mcap_frames)
    assert {*SUFFIXES, "run.mp4", "run.html", "report.json", "frames.csv"} <= everything
    assert not list(tmp_path.rglob("*.part"))
    seed = random.randrange(1 << 32)
    moments = random.Random(seed)
    killed = 0
    for _ in range(KILLS):
        code = server([*arguments, "--overwrite"], moments.uniform(0.2, 1.1) * whole_s)
        killed += code == -signal.SIGKILL
        require_whole(tmp_path, read_mcap_frames)
    assert killed >= KILLS // 4, seed
    assert server([*arguments, "--overwrite"]) == 0, "a killed run is replaced"
    assert require_whole(tmp_path, read_mcap_frames) == everything
    assert not list(tmp_path.rglob("*.part")), "and what it left is cleared away"
    for kind in KINDS:
        assert len(list((tmp_path / "out" / kind).iterdir())) == N
