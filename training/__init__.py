"""Data sets, rendering, losses, metrics and the loop that make checkpoints.

```python
from training import adapt, evaluate, finetune, train

train("lite", data="data", out="run")  # a recipe of the package, or one of yours
finetune("mine/images", labels="mine/labels", classes="mine/classes.txt", out="run")
adapt("drive.mcap", out="rig")  # a recording without labels
print(evaluate(["run", "ssdnet-lite"]))  # on the validation set of the run
```

The functions that train return a `training.run.training_run.RunResult`, whose `path` is the
checkpoint. `evaluate` scores models on data sets, as `ssdnet-eval` does, and returns the scores.
All names are loaded on first use (PEP 562), since they need PyTorch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from training.api import adapt as adapt
    from training.api import evaluate as evaluate
    from training.api import finetune as finetune
    from training.api import train as train

__all__ = ["adapt", "evaluate", "finetune", "train"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module("training.api"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
