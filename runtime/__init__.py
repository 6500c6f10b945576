"""The inference engine: numpy in, numpy out, no PyTorch.

```python
from runtime import Predictor

predictor = Predictor()  # the bundled model on the CPU
prediction = predictor.predict(rgb, sparse_depth)
```

Names are loaded on first use (PEP 562). Code that needs only the contract or the errors, such as
the networks, therefore loads neither OpenCV nor ONNX Runtime.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

# Public name -> the module that defines it, as `__init__.pyi` lists them for type checkers, too.
_HOMES = {
    alias.name: str(node.module)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text()).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}

__all__ = [*_HOMES, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _installed_version()
    elif name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value  # so that the name is looked up only once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("ssdnet")
    except PackageNotFoundError:  # a checkout that was not installed
        return "0+unknown"
