"""The inference engine: numpy in, numpy out, no PyTorch.

```python
from runtime import Predictor

predictor = Predictor()  # the bundled model on the CPU
prediction = predictor.predict(rgb, sparse_depth)
```
"""

from importlib.metadata import PackageNotFoundError, version

from runtime.contract import ClassInfo, Contract
from runtime.errors import (
    CheckpointError,
    ContractError,
    DatasetError,
    InferenceError,
    InputError,
    OutputError,
    ProviderError,
    SSDNetError,
)
from runtime.prediction import Cleaned, Latency, Prediction
from runtime.predictor import Predictor

try:
    __version__ = version("ssdnet")
except PackageNotFoundError:  # a checkout that was not installed
    __version__ = "0+unknown"

__all__ = [
    "CheckpointError",
    "ClassInfo",
    "Cleaned",
    "Contract",
    "ContractError",
    "DatasetError",
    "InferenceError",
    "InputError",
    "Latency",
    "OutputError",
    "Prediction",
    "Predictor",
    "ProviderError",
    "SSDNetError",
    "__version__",
]
