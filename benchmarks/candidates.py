"""Time relatives of ssdnet-lite side by side: what each part of the network costs on this CPU.

Every candidate has random weights and runs as the deploy graph, from uint8 pixels and metres to
full-size answers, interleaved in one ONNX Runtime process:

    python benchmarks/candidates.py --size 512 1024 --repeats 30
"""

import argparse
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from torch.utils.flop_counter import FlopCounterMode

from export.deploy import DeployGraph
from export.trace import trace
from models import SSDNet, SSDNetConfig
from models.registry import NETWORKS

LITE = NETWORKS["ssdnet-lite"].config
#: Networks that start at full size take seconds a frame above this many pixels.
FULL_SIZE_LIMIT = 125 * 414


def candidates() -> dict[str, SSDNetConfig]:
    """Return what is compared, by name; the first is what the others are measured against."""
    bottoms = {
        f"bottom {width}": replace(LITE, encoder_channels=(32, 64, 128, width))
        for width in (192, 224)
    }
    blocks = {
        f"blocks {' '.join(map(str, counts))}": replace(LITE, encoder_blocks=counts)
        for counts in ((1, 1, 1, 1), (1, 2, 2, 2), (1, 1, 2, 2), (1, 2, 2, 3), (2, 2, 2, 1))
    }
    decoders = {
        f"decoder {' '.join(map(str, widths))}": replace(LITE, decoder_channels=widths)
        for widths in ((48, 32, 16), (48, 32, 32), (64, 64, 32), (128, 64, 32))
    }
    return {
        "ssdnet-lite": LITE,
        "no semantic refinement": replace(LITE, semantic_refine_channels=0),
        "no depth prior": replace(LITE, depth_prior=False),
        "no global context": replace(LITE, global_context=False),
        "no depth decoder": replace(LITE, depth_head=False, depth_prior=False),
        "no semantic decoder": replace(
            LITE, semantic_head=False, classes=(), semantic_refine_channels=0
        ),
        "stem 16 32": replace(LITE, stem_channels=(16, 32)),
        "boundary 8": replace(LITE, boundary_channels=8),
        **bottoms,
        **blocks,
        **decoders,
        "wide 48 96 192 256": replace(LITE, encoder_channels=(48, 96, 192, 256)),
        "thin first, deep last": replace(
            LITE, encoder_channels=(32, 64, 128, 256), encoder_blocks=(1, 1, 2, 4)
        ),
        "ssdnet": NETWORKS["ssdnet"].config,
    }


@dataclass(frozen=True)
class Timed:
    """A candidate with its session and its measured times."""

    name: str
    params: int
    gmacs: float
    session: Any
    latencies_ms: list[float]


def count_gmacs(config: SSDNetConfig, size: tuple[int, int]) -> float:
    """Count multiply-accumulates of one frame in 1e9, without computing anything."""
    with torch.device("meta"):
        model = SSDNet(config).eval()
        inputs = torch.empty(1, 3, *size), torch.empty(1, 1, *size)
    counter = FlopCounterMode(display=False)
    with torch.no_grad(), counter:
        model(*inputs)
    return float(counter.get_total_flops()) / 2e9


def open_session(path: Path, threads: int) -> Any:
    """Open the session as the engine does: fixed threads, no spinning."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def prepare(name: str, config: SSDNetConfig, size: tuple[int, int], threads: int) -> Timed:
    """Export a candidate with random weights to a file that is gone again, and open it."""
    torch.manual_seed(0)
    model = SSDNet(config).eval()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "candidate.onnx"
        path.write_bytes(trace(DeployGraph(model), size=size).SerializeToString())
        session = open_session(path, threads)
    params = sum(parameter.numel() for parameter in model.parameters())
    return Timed(name, params, count_gmacs(config, size), session, [])


def measure(timed: list[Timed], size: tuple[int, int], *, repeats: int) -> None:
    """Run all candidates in turn, so that a disturbance hits each of them alike."""
    rng = np.random.default_rng(0)
    sparse = np.where(rng.random((1, *size)) < 0.05, 80 * rng.random((1, *size)), 0)
    feed = {
        "rgb": rng.integers(0, 256, (1, *size, 3), dtype=np.uint8),
        "sparse_depth": sparse.astype(np.float32),
    }
    for repeat in range(repeats + 2):
        for candidate in timed:
            started = time.perf_counter()
            candidate.session.run(None, feed)
            if repeat >= 2:  # warm-up apart
                candidate.latencies_ms.append((time.perf_counter() - started) * 1e3)


def print_table(timed: list[Timed]) -> None:
    """Print a line a candidate: median, fastest, and the median of its ratios to the first."""
    print(
        f"{'candidate':24}{'params M':>9}{'GMACs':>8}{'median ms':>11}{'min ms':>8}"
        f"{'ratio':>7}{'GMAC/s':>8}"
    )
    first = timed[0].latencies_ms
    for candidate in timed:
        times = candidate.latencies_ms
        ratio = statistics.median(a / b for a, b in zip(times, first, strict=True))
        median = statistics.median(times)
        print(
            f"{candidate.name:24}{candidate.params / 1e6:9.2f}{candidate.gmacs:8.2f}"
            f"{median:11.1f}{min(times):8.1f}{ratio:7.2f}{1e3 * candidate.gmacs / median:8.0f}"
        )


def main() -> None:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--size", type=int, nargs=2, default=(512, 1024), metavar=("H", "W"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--only", nargs="*", help="names of candidates; the first is the measure")
    arguments = parser.parse_args()
    size = (arguments.size[0], arguments.size[1])

    chosen = candidates()
    if arguments.only:
        chosen = {name: chosen[name] for name in arguments.only}
    elif size[0] * size[1] > FULL_SIZE_LIMIT:
        chosen = {name: config for name, config in chosen.items() if config.stem_channels}
    timed = [prepare(name, config, size, arguments.threads) for name, config in chosen.items()]
    measure(timed, size, repeats=arguments.repeats)
    print(f"{size[0]} x {size[1]}, {arguments.threads} threads, {arguments.repeats} rounds")
    print_table(timed)


if __name__ == "__main__":
    main()
