"""Small recordings, and what ssdnet-run answers to them."""

import csv
import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime.stream.cli import app


@pytest.fixture
def make_scan():
    """Give float32 (n, 4): x ahead, y to the left, z up [m], reflectance."""

    def make(seed: int = 0, n: int = 300) -> np.ndarray:
        random = np.random.default_rng(seed)
        x = random.uniform(5, 40, n)
        y, z = x * random.uniform(-0.5, 0.5, n), x * random.uniform(-0.3, 0.3, n)
        return np.stack([x, y, z, random.random(n)], axis=1).astype(np.float32)

    return make


class Answers:
    """What a run left: exit code, text, report, rows, and the depth that the network was fed."""

    def __init__(self, result, out) -> None:
        self.exit_code, self.text, self._out = result.exit_code, result.output, out
        if (out / "report.json").exists():
            self.report = json.loads((out / "report.json").read_text())
            self.rows = list(csv.DictReader((out / "frames.csv").open()))
            self.names = [row["name"] for row in self.rows]

    def fed_depth(self, name):
        """The model by hand answers what it is fed and 1.5 m more; a PNG rounds to 1/256 m."""
        answer = cv2.imread(str(self._out / f"depth/{name}.png"), cv2.IMREAD_UNCHANGED) / 256
        return answer - 1.5

    def column(self, name):
        return [row[name] for row in self.rows]


@pytest.fixture
def run(tmp_path, model_file):
    """Run ssdnet-run with the model by hand and give its Answers."""
    model = model_file(heads=("semantic", "depth"))  # lossy pictures have no boundary by hand

    def invoke(*arguments: object, out="out"):
        standard = ["--model", model, "--out", tmp_path / out, "--threads", 1, "--warmup", 1]
        standard += ["--save", "depth"]
        result = CliRunner().invoke(app, [str(a) for a in [*standard, *arguments]])
        return Answers(result, tmp_path / out)

    return invoke


@pytest.fixture
def write_rgb():
    """Write a picture, red first."""

    def write(path, rgb):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), rgb[..., ::-1])

    return write


@pytest.fixture
def write_depth():
    """Write a 16-bit PNG."""

    def write(path, metres, *, units_a_metre=256):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.rint(metres * units_a_metre).astype(np.uint16))

    return write
