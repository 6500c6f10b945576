"""What it costs that the graph looks for scores that are not finite: with and without, in turns.

    python benchmarks/finite_check.py [--rounds 60]

Two deploy graphs of ssdnet-lite with random weights at 512 x 1024 on 2 threads; the plain one has
the arg-max alone. Each round runs both, in alternating order. Printed are the clock and the
processor's time of both threads, which other programs lengthen less.
"""

import argparse
import time
from typing import Any

import numpy as np
import torch

from export import deploy
from export.trace import trace
from models import create_model
from runtime.session import open_session

SIZE = (512, 1024)


def plain_best_class(logits: torch.Tensor) -> torch.Tensor:
    """Class ids uint8 (N, H, W) of (N, C, H, W), without a look at NaN."""
    batch, classes, height, width = logits.shape
    ids = logits.permute(0, 2, 3, 1).reshape(-1, classes).argmax(dim=1)
    return ids.to(torch.uint8).reshape(batch, height, width)


def make_session(best_class: Any) -> Any:
    """Trace ssdnet-lite with this arg-max and open it."""
    before, deploy._best_class = deploy._best_class, best_class
    try:
        torch.manual_seed(0)
        graph = deploy.DeployGraph(create_model("ssdnet-lite").eval())
        content = trace(graph, size=SIZE).SerializeToString()
    finally:
        deploy._best_class = before
    return open_session(content, provider="cpu", device_id=0, threads=2)


def main() -> None:
    """Print medians and ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=60)
    rounds = parser.parse_args().rounds
    sessions = {
        "plain": make_session(plain_best_class),
        "checked": make_session(deploy._best_class),
    }
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 80, (1, *SIZE)) * (rng.random((1, *SIZE)) < 0.05)
    feed = {
        "rgb": rng.integers(0, 256, (1, *SIZE, 3), dtype=np.uint8),
        "sparse_depth": depth.astype(np.float32),
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in sessions}
    for turn in range(-2, rounds):
        for name in list(sessions)[:: 1 if turn % 2 else -1]:
            clock, processor = time.perf_counter(), time.process_time()
            sessions[name].run(None, feed)
            if turn >= 0:
                spent = time.perf_counter() - clock, time.process_time() - processor
                times[name].append(spent)
    plain, checked = (np.array(times[name]) * 1e3 for name in ("plain", "checked"))
    for place, what in enumerate(("clock", "processor")):
        ratios = checked[:, place] / plain[:, place]
        low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
        print(
            f"{what}: plain {np.median(plain[:, place]):.1f} ms, checked "
            f"{np.median(checked[:, place]):.1f} ms, ratio round by round {middle:.3f} "
            f"(quartiles {low:.3f} to {high:.3f}), n = {rounds}"
        )


if __name__ == "__main__":
    main()
