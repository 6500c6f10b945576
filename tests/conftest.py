"""What tests of every part share: small models whose right answers can be worked out by hand."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # pytest runs two workers; before NumPy and PyTorch

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from runtime.contract.contract import METADATA_KEY, SCHEMA_VERSION, ClassInfo, Contract
from runtime.contract.model_file import with_contract

cv2.setNumThreads(1)


def pytest_configure():
    """Hear Ctrl-C and a closed terminal, as the processes of tests do.

    A shell's background ignores the first, and nohup the second.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(autouse=True)
def one_thread():
    """Take back the threads that a command or an opened checkpoint has given to PyTorch."""
    yield
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)


MAX_DEPTH_M = 80.0
DEPTH_OFFSET_M = 1.5

CONTRACT = Contract(
    schema_version=SCHEMA_VERSION,
    model_name="by-hand",
    classes=(ClassInfo("dark", (0, 0, 128)), ClassInfo("red", (200, 30, 30))),
    max_depth_m=MAX_DEPTH_M,
    native_size=(48, 64),
    stride=1,
    precision="fp32",
    training={"data": [], "terms": "none"},
    versions={"opset": "20"},
    parity={},
    checkpoint_sha256="0" * 64,
)


def make_model(
    *,
    size: tuple[int, int] | None = None,
    heads: tuple[str, ...] = ("semantic", "depth", "boundary"),
    rgb_type: int = TensorProto.UINT8,
    opset: int = 20,
    only_runs_at: tuple[int, int] | None = None,
) -> onnx.ModelProto:
    """Make a model of fixed `size` (height, width) or of any, with these answers.

    semantic = 1 where red >= 128, else 0
    depth = sparse_depth + DEPTH_OFFSET_M, without cleaning: a NaN in would be a NaN out
    boundary = green / blue, NaN where both are 0
    depth_uncertainty = depth / 16
    semantic_logits = (red, -red)

    only_runs_at: the graph fails for frames of another size.
    """
    height, width = size or ("H", "W")
    initializers = {
        "red_at": np.array(0), "green_at": np.array(1), "blue_at": np.array(2),
        "half": np.float32(128), "offset": np.float32(DEPTH_OFFSET_M),
        "sixteenth": np.float32(1 / 16), "channel_axis": np.array([1]),
    }  # fmt: skip
    nodes = [
        helper.make_node("Cast", ["rgb"], ["colors"], to=TensorProto.FLOAT),
        *(
            helper.make_node("Gather", ["colors", f"{color}_at"], [color], axis=3)
            for color in ("red", "green", "blue")
        ),
        helper.make_node("GreaterOrEqual", ["red", "half"], ["is_red"]),
        helper.make_node("Cast", ["is_red"], ["semantic"], to=TensorProto.UINT8),
        helper.make_node("Div", ["green", "blue"], ["boundary"]),
        helper.make_node("Unsqueeze", ["red", "channel_axis"], ["logit"]),
        helper.make_node("Neg", ["logit"], ["minus"]),
        helper.make_node("Concat", ["logit", "minus"], ["semantic_logits"], axis=1),
    ]
    depth = "sparse_depth"
    if only_runs_at is not None:
        initializers["plane"] = np.zeros((1, *only_runs_at), np.float32)
        nodes.append(helper.make_node("Add", [depth, "plane"], ["same_depth"]))
        depth = "same_depth"
    nodes.append(helper.make_node("Add", [depth, "offset"], ["depth"]))
    nodes.append(helper.make_node("Mul", ["depth", "sixteenth"], ["depth_uncertainty"]))
    plane = ["N", height, width]
    outputs = {
        "semantic": (TensorProto.UINT8, plane),
        "depth": (TensorProto.FLOAT, plane),
        "boundary": (TensorProto.FLOAT, plane),
        "depth_uncertainty": (TensorProto.FLOAT, plane),
        "semantic_logits": (TensorProto.FLOAT, ["N", 2, height, width]),
    }
    graph = helper.make_graph(
        nodes,
        "by_hand",
        [
            helper.make_tensor_value_info("rgb", rgb_type, ["N", height, width, 3]),
            helper.make_tensor_value_info("sparse_depth", TensorProto.FLOAT, plane),
        ],
        [helper.make_tensor_value_info(head, *outputs[head]) for head in heads],
        [numpy_helper.from_array(np.asarray(v), name) for name, v in initializers.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)


ModelFile = Callable[..., Path]


@pytest.fixture
def model_file(tmp_path: Path) -> ModelFile:
    """Write a model made by `make_model` (same arguments) and give back its path.

    edit: changes the model's graph before it is written
    contract: what is written as its metadata; None = `metadata` as it is, or nothing
    """

    def write(
        name: str = "model.onnx",
        *,
        contract: Contract | None = CONTRACT,
        metadata: str | None = None,
        edit: Callable[[onnx.GraphProto], object] = lambda graph: None,
        **options: object,
    ) -> Path:
        model = make_model(**options)
        edit(model.graph)
        path = tmp_path / name
        if contract is not None:
            path.write_bytes(with_contract(model.SerializeToString(), contract))
            return path
        if metadata is not None:
            helper.set_model_props(model, {METADATA_KEY: metadata})
        path.write_bytes(model.SerializeToString())
        return path

    return write


@pytest.fixture
def contract() -> Contract:
    return CONTRACT


@pytest.fixture
def change_run(monkeypatch):
    """Have `answer(run, feed)` called wherever a session runs; `run()` is ONNX Runtime's answer."""
    import onnxruntime

    run = onnxruntime.InferenceSession.run

    def change(answer):
        def changed(session, heads, feed):
            return answer(lambda: run(session, heads, feed), feed)

        monkeypatch.setattr(onnxruntime.InferenceSession, "run", changed)

    return change


Frame = tuple[np.ndarray, np.ndarray]


@pytest.fixture
def make_frame() -> Callable[..., Frame]:
    """Give (rgb, sparse_depth): random colours, 0 < green <= blue, and 5 % random returns."""

    def make(height: int = 48, width: int = 64, seed: int = 0) -> Frame:
        random = np.random.default_rng(seed)
        rgb = random.integers(1, 256, (height, width, 3), dtype=np.uint8)
        rgb[..., 1] = np.minimum(rgb[..., 1], rgb[..., 2])  # green / blue is a probability
        depth = random.uniform(1, MAX_DEPTH_M - DEPTH_OFFSET_M, (height, width)).astype(np.float32)
        depth[random.random((height, width)) > 0.05] = 0
        return rgb, depth

    return make


@pytest.fixture
def read_ply() -> Callable[[Path], tuple[list[str], np.ndarray]]:
    """Read whatever a PLY file of one element holds: (lines of the header, structured array)."""

    def read(path: Path) -> tuple[list[str], np.ndarray]:
        header, content = path.read_bytes().split(b"end_header\n", 1)
        lines = header.decode("ascii").splitlines()
        assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
        (count,) = [int(line.split()[2]) for line in lines if line.startswith("element vertex")]
        types = {"float": "<f4", "uchar": "u1"}
        properties = [line.split()[1:] for line in lines if line.startswith("property")]
        points = np.frombuffer(content, [(name, types[kind]) for kind, name in properties])
        assert len(points) == count
        return lines, points

    return read


class Page(HTMLParser):
    """Texts of a page, and whatever it would load."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.links, self.tags = [], [], []
        self.feed(text)
        assert self.tags == [], "every tag is closed"

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "link", "img", "br"):
            self.tags.append(tag)
        for name, value in attributes:
            if name in ("src", "href", "srcset", "data", "xlink:href", "action"):
                self.links.append(value)

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.tags.pop() == tag

    def handle_data(self, data):
        if text := data.strip():
            self.texts.append(text)

    def after(self, label):
        """The text that follows a label."""
        return self.texts[self.texts.index(label) + 1]


@pytest.fixture
def read_page():
    """Read the source of a page."""
    return Page


@pytest.fixture
def start_process():
    """Start a process in a group of its own, with pipes; none outlives its test."""
    started = []

    def start(*command, **options):
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE) | options
        command = [str(part) for part in command]
        started.append(subprocess.Popen(command, text=True, start_new_session=True, **pipes))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()  # torchrun ends its own
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.fixture
def bench_in_threads(monkeypatch):
    """Let ssdnet-bench start threads: processes take seconds to start."""
    threads = lambda workers, *_, **__: ThreadPoolExecutor(workers)  # noqa: E731
    monkeypatch.setattr("runtime.app.tools.bench.ProcessPoolExecutor", threads)


@pytest.fixture
def mount():
    """Give a function that calls `mount` with its arguments, the last one a folder."""
    mounted = []

    def call(*arguments):
        command = ["mount", *map(str, arguments)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("mounting is not permitted here")
        mounted.append(arguments[-1])

    yield call
    for folder in mounted:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)  # a file may be open yet


@pytest.fixture
def read_only(mount):
    """Give a function that makes a folder read-only even for root."""

    def make(folder):
        mount("--bind", folder, folder)
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)

    return make


@pytest.fixture
def mount_disk(tmp_path, mount):
    """Give a function that mounts a real file system of so many kilobytes: its folder."""

    def make(kilobytes):
        disk = Path(tempfile.mkdtemp(prefix="disk", dir=tmp_path))
        mount("-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", disk)
        return disk

    return make
