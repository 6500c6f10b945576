"""The memory in C++ adds the same returns as that of Python."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from drive_to_wall import CALIBRATION, PERIOD_NS, SIZE, pose, scan
from runtime import ScanMemory

HEADER = Path(__file__).parents[2] / "examples" / "cpp"
PROGRAM = r"""
#include <cstdio>
#include "ssdnet_memory.hpp"
int main() {
  const ssdnet::Camera camera{%d, %d, 100, 100, 100, 40};
  std::vector<float> depth(camera.height * camera.width);
  std::vector<std::uint8_t> moves(depth.size());
  ssdnet::ScanMemory::Pose pose;
  ssdnet::ScanMemory memory;
  for (std::int64_t stamp = 0; std::fread(pose.data(), 8, 16, stdin) == 16; stamp += %d) {
    if (std::fread(depth.data(), 4, depth.size(), stdin) != depth.size()) return 1;
    const auto& found = memory.recall(depth.data(), camera, pose, stamp);
    std::fwrite(found.data(), 4, found.size(), stdout);
    for (std::size_t i = 0; i < moves.size(); ++i) moves[i] = i %% 200 < 60;
    memory.answered(moves);
  }
}
"""


class Answer:
    """An answer whose first 60 columns are a car."""

    class_names = ("road", "car")
    semantic = np.zeros(SIZE, np.uint8)
    semantic[:, :60] = 1


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_returns_are_those_of_python(tmp_path):
    source, program = tmp_path / "memory.cpp", tmp_path / "memory"
    source.write_text(PROGRAM % (*SIZE, PERIOD_NS))
    flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", f"-I{HEADER}"]
    subprocess.run(["g++", *flags, source, "-o", program], check=True)
    memory, expected, given = ScanMemory(), [], b""
    poses = [pose(number * 0.7, (4.5e5, 5.4e6, 100.0), 0.3 * number) for number in range(12)]
    poses += [pose(9.0 + 1.3 * number, (4.5e5, 5.4e6, 100.0), 3.3) for number in range(12)]  # wrong
    for number, camera in enumerate(poses):
        depth = scan(0.7 * number)
        depth[50, 9], depth[51, 9] = np.nan, -1
        given += camera.tobytes() + depth.tobytes()
        expected.append(memory.recall(depth, camera, number * PERIOD_NS, CALIBRATION).returns)
        memory.answered(Answer())
    printed = subprocess.run([program], input=given, capture_output=True, check=True).stdout
    found = np.frombuffer(printed, np.float32).reshape(-1, *SIZE)
    for number, (cpp, python) in enumerate(zip(found, expected, strict=True)):
        differ = np.abs(cpp - python) > 1e-4 * python
        assert np.count_nonzero(differ) <= 0.002 * np.count_nonzero(python), number
    counts = [np.count_nonzero(each) for each in expected]
    assert counts[11] > 500
    assert counts[-1] == 0  # switched off
