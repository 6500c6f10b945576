"""Time relatives of ssdnet-lite side by side: what each part of the network costs on this CPU.

Every candidate has random weights and runs as the deploy graph, from uint8 pixels and metres to
full-size answers, interleaved in one ONNX Runtime process:

    python benchmarks/candidates.py --size 512 1024 --repeats 30
"""

import argparse
from dataclasses import replace

import torch

from models import SSDNet, SSDNetConfig
from models.registry import NETWORKS
from timing import deploy, describe, figures, machine, measure, open_timed, to_markdown

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
        for counts in ((1, 1, 1, 1), (2, 2, 2, 2), (1, 1, 2, 2), (1, 2, 2, 3), (1, 2, 2, 1))
    }
    decoders = {
        f"decoder {' '.join(map(str, widths))}": replace(LITE, decoder_channels=widths)
        for widths in ((48, 32, 16), (48, 32, 32), (64, 64, 32), (128, 64, 32))
    }
    return {
        "ssdnet-lite": LITE,
        "no semantic refinement": replace(LITE, semantic_refine_channels=0),
        "no measured surfaces": replace(LITE, depth_surfaces=False, depth_refine_channels=0),
        "surfaces at a quarter": replace(LITE, depth_refine_channels=0),
        "no global context": replace(LITE, global_context=False),
        "no depth decoder": replace(
            LITE, depth_head=False, depth_surfaces=False, depth_refine_channels=0
        ),
        "no semantic decoder": replace(
            LITE, semantic_head=False, classes=(), semantic_refine_channels=0
        ),
        "stem 32 32": replace(LITE, stem_channels=(32, 32)),
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
    unknown = [name for name in arguments.only or () if name not in chosen]
    if unknown:
        parser.error(f"--only {unknown[0]!r}: no such candidate; known: {', '.join(chosen)}")
    if arguments.only:
        chosen = {name: chosen[name] for name in arguments.only}
    elif size[0] * size[1] > FULL_SIZE_LIMIT:
        chosen = {name: config for name, config in chosen.items() if config.stem_channels}
    where = machine(threads=arguments.threads, rounds=arguments.repeats)
    timed = []
    for name, config in chosen.items():
        torch.manual_seed(0)
        model = deploy(SSDNet(config), size)
        item = open_timed(name, model, size, threads=arguments.threads)
        assert item is not None  # exported at this size
        timed.append(item)
    measure(timed, size, rounds=arguments.repeats)
    print(f"{describe(where)}; {size[0]} x {size[1]}\n")
    print(to_markdown(figures(timed, timed[0]), timed[0].name))


if __name__ == "__main__":
    main()
