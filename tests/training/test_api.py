"""The names of the package `training`, which are its face for Python."""

import subprocess
import sys

import training


def test_the_names_are_loaded_on_first_use():
    """`import training` needs no PyTorch; modules of the package hide no name."""
    code = (
        "import sys, training\n"
        "assert 'torch' not in sys.modules\n"
        "import training.fine_tuning.adaptation, training.evaluation.evaluate, training.run.loop\n"
        "assert all(callable(getattr(training, name)) for name in training.__all__)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert set(training.__all__) <= set(dir(training))
