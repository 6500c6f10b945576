"""The page of examples/browser gives the engine's answers, in headless Chromium."""

import dataclasses
import functools
import http.server
import json
import os
import re
import shutil
import subprocess
import threading
import time
import urllib.request
from base64 import b64decode, b64encode
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.contract.agreement import compare, reference_limits, within
from runtime.contract.canonical_focal import camera_scale
from runtime.contract.heads import HEADS
from runtime.contract.model_file import load_model_file, with_contract
from runtime.contract.resize import move_returns
from runtime.engine.bundled_models import find_model, list_bundled_models
from runtime.recordings.bundled_stream import bundled_frames

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NEEDED = ("npm", "chromium", "chromedriver")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--disable-renderer-backgrounding"),
)
TIMEOUT_S = 600


class Page:
    """The page in a session of ChromeDriver, which speaks JSON over HTTP."""

    def __init__(self, driver, address):
        self._url = driver + "/session"
        options = {"binary": shutil.which("chromium"), "args": FLAGS}
        timeouts = {"script": TIMEOUT_S * 1000, "pageLoad": TIMEOUT_S * 1000}
        asked = {"goog:chromeOptions": options, "timeouts": timeouts}
        session = self._post("", {"capabilities": {"alwaysMatch": asked}})
        self._url += "/" + session["sessionId"]
        self._post("/url", {"url": address})

    def close(self):
        request = urllib.request.Request(self._url, method="DELETE")
        urllib.request.urlopen(request, timeout=TIMEOUT_S).close()

    def run(self, script, *arguments):
        """What a script returns."""
        return self._post("/execute/sync", {"script": script, "args": arguments})

    def drop(self, *paths):
        """Drop files on the page; return the error that it shows."""
        files = [(path.name, b64encode(path.read_bytes()).decode()) for path in paths]
        script = """const dataTransfer = new DataTransfer();
            for (const [name, content] of arguments[0])
              dataTransfer.items.add(new File([Uint8Array.fromBase64(content)], name));
            document.dispatchEvent(new DragEvent("drop", { dataTransfer }));"""
        self.run(script, files)
        return self.error()

    def set_focal_length(self, pixels):
        self.run("focal.value = arguments[0]; focal.onchange();", pixels or "")
        self.error()

    def error(self):
        """The error that is shown once the page has done its work."""
        self.wait_for("return document.body.className === ''")
        return self.run("return document.getElementById('error').textContent")

    def wait_for(self, condition):
        deadline = time.monotonic() + TIMEOUT_S
        while not self.run(condition):
            assert time.monotonic() < deadline, self.run("return document.body.innerText")
            time.sleep(0.05)

    def answer(self):
        """Head -> plane."""
        script = """const { pixels, answer } = shown;
            const base64 = ({ buffer, byteOffset, byteLength }) =>
              new Uint8Array(buffer, byteOffset, byteLength).toBase64();
            const planes = Object.entries(answer.heads).map(([k, plane]) => [k, base64(plane)]);
            return [[pixels.height, pixels.width], Object.fromEntries(planes)];"""
        size, heads = self.run(script)
        return {
            head: np.frombuffer(b64decode(plane), HEADS[head].dtype).reshape(size)
            for head, plane in heads.items()
        }

    def _post(self, path, body):
        request = urllib.request.Request(self._url + path, json.dumps(body).encode())
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as response:
            return json.load(response)["value"]


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Serve a copy of the page with its packages, beside the bundled files."""
    if missing := [program for program in NEEDED if shutil.which(program) is None]:
        end = pytest.fail if os.environ.get("SSDNET_BROWSER") == "required" else pytest.skip
        end(f"{' and '.join(missing)} not installed")
    root = tmp_path_factory.mktemp("site")
    folder = root / "examples" / "browser"
    shutil.copytree(ROOT / "examples" / "browser", folder, ignore=shutil.ignore_patterns("node_*"))
    (root / "runtime").symlink_to(ROOT / "runtime")
    npm = ["npm", "install", "--ignore-scripts", "--no-audit", "--no-fund"]
    installed = subprocess.run(npm, cwd=folder, capture_output=True, text=True, check=False)
    assert installed.returncode == 0, installed.stderr

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

    handler = functools.partial(Handler, directory=str(root))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/examples/browser/"
        server.shutdown()
    shutil.rmtree(root)  # 150 MB


@pytest.fixture(scope="module")
def page(address):
    driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True)
    try:
        lines = iter(driver.stdout.readline, "")
        (port,) = next(filter(None, (re.findall(r"started .* on port (\d+)", x) for x in lines)))
        opened = Page(f"http://127.0.0.1:{port}", address)
        yield opened
        opened.close()
    finally:
        driver.kill()
        driver.communicate()


@pytest.fixture
def by_hand(model_file, contract):
    """Write a model whose answers can be worked out by hand."""
    contract = dataclasses.replace(contract, trained_height=40, canonical_focal_px=700.0)
    return functools.partial(model_file, contract=contract)


@pytest.fixture
def frame_files(make_frame, tmp_path):
    """Write a frame; return its arrays, as the files hold them, and the files."""

    def write(height, width):
        rgb, depth = make_frame(height, width)
        depth[depth > 60] = 78  # m: nothing at the end of a range
        paths = tmp_path / "frame.png", tmp_path / "frame_depth.png"
        steps = np.rint(depth * 256).astype(np.uint16)
        for path, pixels in zip(paths, (rgb[..., ::-1], steps), strict=True):
            assert cv2.imwrite(str(path), pixels)
        return rgb, (steps / 256).astype(np.float32), paths

    return write


@pytest.mark.parametrize("name", ["", *list_bundled_models()])
def test_it_gives_the_engines_answer_to_a_bundled_frame(page, name):
    """It opens with the answer of the default model; others are dropped on it."""
    assert (page.drop(find_model(name)) if name else page.error()) == ""
    frame, answer = bundled_frames()[0], page.answer()
    with Predictor(*filter(None, [name])) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
        contract = predictor.contract
    assert answer.keys() == prediction.heads.keys()
    assert re.search(r"\b[1-9][0-9]* ms", page.run("return document.body.innerText"))
    if contract.precision == "int8":
        for head, values in answer.items():
            limits = reference_limits(head, contract, from_torch=False)
            assert within(compare(head, values, prediction.heads[head]), limits), head
        return
    assert (answer["semantic"] == prediction.semantic).mean() >= 0.999
    for head in ("depth", "depth_uncertainty"):
        assert (np.abs(answer[head] - prediction.heads[head]) <= 0.01).mean() >= 0.999, head
    assert np.abs(answer["boundary"] - prediction.boundary).max() <= 0.01


@pytest.mark.parametrize(("fixed", "frame_size", "network_size", "focal_px"), [
    (None, (50, 64), (50, 64), None),  # not a quarter more than the trained height
    ((40, 200), (96, 129), (40, 200), 350.0),
])  # fmt: skip
def test_returns_are_fed_as_the_engine_feeds_them(
    page, by_hand, frame_files, fixed, frame_size, network_size, focal_px
):
    rgb, depth, paths = frame_files(*frame_size)
    model = by_hand(size=fixed, heads=("semantic", "depth", "boundary", "depth_uncertainty"))
    page.set_focal_length(focal_px)
    error, answer = page.drop(model, *paths), page.answer()
    page.set_focal_length(None)
    # Returns at the end of the range are answered beyond it, as by this model in the engine.
    with Predictor(model, size=None if fixed else "frame") as predictor:
        valid = predictor.predict(rgb, depth, focal_length_px=focal_px).valid
    assert valid == (error == ""), error
    assert valid == (focal_px is None)
    scale = camera_scale(80.0, 700.0, focal_px, frame_size=frame_size, network_size=network_size)
    fed = move_returns(np.minimum(depth, scale.range_m), network_size)
    np.testing.assert_allclose(answer["depth"], fed + 1.5 / scale.factor, rtol=1e-6)
    np.testing.assert_array_equal(answer["depth_uncertainty"], answer["depth"] / 16)
    if network_size == frame_size:
        np.testing.assert_array_equal(answer["semantic"], rgb[..., 0] >= 128)
        np.testing.assert_array_equal(answer["boundary"], rgb[..., 1] / rgb[..., 2].astype("f4"))


def hostile(path):
    """Give the first class a colour that is CSS; the digests are right."""
    contract = load_model_file(path).contract
    first, *others = contract.classes
    first = dataclasses.replace(first, color=("0), url(/stolen), rgb(0", 0, 0))
    contract = dataclasses.replace(contract, classes=(first, *others))
    path.write_bytes(with_contract(path.read_bytes()[: contract.content.bytes], contract))


WRONG = {
    "half a model": (
        lambda model, image, depth: model.write_bytes(model.read_bytes()[:-9]),
        "model.onnx is damaged",
    ),
    "a colour that is CSS": (
        lambda model, image, depth: hostile(model),
        "not three whole numbers of 0 to 255",
    ),
    "depth of another size": (
        lambda model, image, depth: cv2.imwrite(str(depth), np.ones((48, 63), np.uint16)),
        "drop its own depth",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_named_in_words(page, by_hand, frame_files, case):
    _, _, paths = frame_files(48, 64)
    spoil, message = WRONG[case]
    model = by_hand()
    assert page.drop(model, *paths) == ""
    before = page.run("return document.body.innerText")
    spoil(model, *paths)
    error = page.drop(model, *paths)
    assert message in error
    assert page.run("return document.body.innerText").replace(error, "").split() == before.split()
