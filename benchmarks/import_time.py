"""What the engine adds to `import onnxruntime`, in fresh processes that take turns.

python benchmarks/import_time.py [--rounds 15]
"""

import argparse
import statistics
import subprocess
import sys

#: The clock starts inside the process, so that the interpreter's own start is left out.
PROGRAM = "import time; t = time.perf_counter(); {imports}; print(time.perf_counter() - t)"
ENGINE, BARE = "import onnxruntime; from runtime import Predictor", "import onnxruntime"


def main() -> None:
    """Print medians and the median of the differences, in seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    seconds(BARE), seconds(ENGINE)  # the first of each fills the file cache
    pairs = [(seconds(BARE), seconds(ENGINE)) for _ in range(rounds)]
    bare, engine = (statistics.median(column) for column in zip(*pairs, strict=True))
    added = statistics.median(b - a for a, b in pairs)
    print(f"{BARE}: {bare:.3f} s")
    print(f"{ENGINE}: {engine:.3f} s")
    print(f"added: {added:.3f} s (median of {rounds} differences)")


def seconds(imports: str) -> float:
    """Time the imports in a fresh interpreter."""
    command = [sys.executable, "-c", PROGRAM.format(imports=imports)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


if __name__ == "__main__":
    main()
