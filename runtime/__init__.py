"""The inference engine: numpy in, numpy out, no PyTorch.

```python
from runtime import Predictor

predictor = Predictor()  # the bundled model on the CPU
prediction = predictor.predict(rgb, sparse_depth)
```

Names are loaded on first use (PEP 562). Code that needs only the contract or the errors, such as
the networks, therefore loads neither OpenCV nor ONNX Runtime.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runtime.alignment.calibrate import CalibrationResult as CalibrationResult
    from runtime.alignment.calibrate import calibrate as calibrate
    from runtime.base.errors import ContractError as ContractError
    from runtime.base.errors import InferenceError as InferenceError
    from runtime.base.errors import InputError as InputError
    from runtime.base.errors import OutputError as OutputError
    from runtime.base.errors import ProviderError as ProviderError
    from runtime.base.errors import SSDNetError as SSDNetError
    from runtime.contract.contract import ClassInfo as ClassInfo
    from runtime.contract.contract import Contract as Contract
    from runtime.engine.bundled_models import list_bundled_models as list_bundled_models
    from runtime.engine.prediction import Cleaned as Cleaned
    from runtime.engine.prediction import Latency as Latency
    from runtime.engine.prediction import Prediction as Prediction
    from runtime.engine.predictor import Predictor as Predictor
    from runtime.geometry.assumptions import AssumptionWarning as AssumptionWarning
    from runtime.geometry.calibration import Calibration as Calibration
    from runtime.geometry.point_cloud import PointCloud as PointCloud
    from runtime.geometry.projection import project_points as project_points
    from runtime.geometry.rig import Rig as Rig
    from runtime.recordings.registry import open_source as open_source
    from runtime.recordings.source import Source as Source
    from runtime.streams.frame_result import FrameResult as FrameResult
    from runtime.streams.push_stream import PushStream as PushStream
    from runtime.streams.replay import ReplayMessage as ReplayMessage
    from runtime.streams.replay import replay as replay
    from runtime.streams.stream_counter import StreamCounter as StreamCounter
    from runtime.streams.stream_counter import WatchdogLimits as WatchdogLimits

    __version__: str

# Module -> its public names.
_MODULES = {
    "alignment.calibrate": "CalibrationResult calibrate",
    "engine.bundled_models": "list_bundled_models",
    "contract.contract": "ClassInfo Contract",
    "base.errors": "ContractError InferenceError InputError OutputError ProviderError SSDNetError",
    "geometry.assumptions": "AssumptionWarning",
    "geometry.calibration": "Calibration",
    "geometry.point_cloud": "PointCloud",
    "geometry.projection": "project_points",
    "geometry.rig": "Rig",
    "engine.prediction": "Cleaned Latency Prediction",
    "engine.predictor": "Predictor",
    "recordings.registry": "open_source",
    "recordings.source": "Source",
    "streams.frame_result": "FrameResult",
    "streams.push_stream": "PushStream",
    "streams.replay": "ReplayMessage replay",
    "streams.stream_counter": "StreamCounter WatchdogLimits",
}
_HOMES = {name: f"runtime.{home}" for home, names in _MODULES.items() for name in names.split()}

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
