"""The inference engine: numpy in, numpy out, no PyTorch.

```python
from runtime import Predictor

predictor = Predictor()  # the bundled model on the CPU
prediction = predictor.predict(rgb, sparse_depth)
```

Names are loaded on first use (PEP 562): code that needs only the contract or the errors, as the
networks do, loads neither OpenCV nor ONNX Runtime.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runtime.bundled_models import list_bundled_models
    from runtime.contract import ClassInfo, Contract
    from runtime.errors import (
        ContractError,
        InferenceError,
        InputError,
        OutputError,
        ProviderError,
        SSDNetError,
    )
    from runtime.live.push_stream import PushStream
    from runtime.prediction import Cleaned, Latency, Prediction
    from runtime.predictor import Predictor
    from runtime.projection import OcclusionFilter, project_points

    __version__: str

#: Public name -> the module that holds it.
_MODULES = {
    "ClassInfo": "runtime.contract",
    "Cleaned": "runtime.prediction",
    "Contract": "runtime.contract",
    "ContractError": "runtime.errors",
    "InferenceError": "runtime.errors",
    "InputError": "runtime.errors",
    "Latency": "runtime.prediction",
    "OcclusionFilter": "runtime.projection",
    "OutputError": "runtime.errors",
    "Prediction": "runtime.prediction",
    "Predictor": "runtime.predictor",
    "ProviderError": "runtime.errors",
    "PushStream": "runtime.live.push_stream",
    "SSDNetError": "runtime.errors",
    "list_bundled_models": "runtime.bundled_models",
    "project_points": "runtime.projection",
}

__all__ = [
    "ClassInfo",
    "Cleaned",
    "Contract",
    "ContractError",
    "InferenceError",
    "InputError",
    "Latency",
    "OcclusionFilter",
    "OutputError",
    "Prediction",
    "Predictor",
    "ProviderError",
    "PushStream",
    "SSDNetError",
    "__version__",
    "list_bundled_models",
    "project_points",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _installed_version()
    elif name in _MODULES:
        value = getattr(import_module(_MODULES[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value  # looked up once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("ssdnet")
    except PackageNotFoundError:  # a checkout that was not installed
        return "0+unknown"
