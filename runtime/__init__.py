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
    from runtime.alignment.calibrate import Verdict as Verdict
    from runtime.alignment.calibrate import calibrate as calibrate
    from runtime.alignment.fit_scores import FitScores as FitScores
    from runtime.base.errors import ContractError as ContractError
    from runtime.base.errors import InferenceError as InferenceError
    from runtime.base.errors import InputError as InputError
    from runtime.base.errors import OutputError as OutputError
    from runtime.base.errors import ProviderError as ProviderError
    from runtime.base.errors import SSDNetError as SSDNetError
    from runtime.contract.canonical_focal import CameraScale as CameraScale
    from runtime.contract.contract import ClassInfo as ClassInfo
    from runtime.contract.contract import Contract as Contract
    from runtime.contract.contract import ModelContent as ModelContent
    from runtime.engine.bundled_models import list_bundled_models as list_bundled_models
    from runtime.engine.prediction import Cleaned as Cleaned
    from runtime.engine.prediction import HeadArrays as HeadArrays
    from runtime.engine.prediction import Latency as Latency
    from runtime.engine.prediction import Prediction as Prediction
    from runtime.engine.predictor import Predictor as Predictor
    from runtime.geometry.assumptions import AssumptionWarning as AssumptionWarning
    from runtime.geometry.calibration import Calibration as Calibration
    from runtime.geometry.lens import Lens as Lens
    from runtime.geometry.motion import CompensatedDepth as CompensatedDepth
    from runtime.geometry.motion import Scan as Scan
    from runtime.geometry.point_cloud import PointCloud as PointCloud
    from runtime.geometry.poses import PoseFrame as PoseFrame
    from runtime.geometry.poses import PoseTrack as PoseTrack
    from runtime.geometry.projection import project_points as project_points
    from runtime.geometry.rig import Rig as Rig
    from runtime.recordings.registry import open_source as open_source
    from runtime.recordings.ros_answers import FixedTransform as FixedTransform
    from runtime.recordings.ros_answers import SensorFrames as SensorFrames
    from runtime.recordings.source import ListedFrame as ListedFrame
    from runtime.recordings.source import Source as Source
    from runtime.streams.answerer import FramePredictor as FramePredictor
    from runtime.streams.frame import Frame as Frame
    from runtime.streams.frame import Message as Message
    from runtime.streams.frame import Outcome as Outcome
    from runtime.streams.frame import Sensor as Sensor
    from runtime.streams.frame_result import FrameResult as FrameResult
    from runtime.streams.health.consistency import Consistency as Consistency
    from runtime.streams.push_stream import PushStream as PushStream
    from runtime.streams.replay import ReplayMessage as ReplayMessage
    from runtime.streams.replay import replay as replay
    from runtime.streams.statistics import LatencyStatistics as LatencyStatistics
    from runtime.streams.statistics import MissedDeadlines as MissedDeadlines
    from runtime.streams.statistics import StreamStatistics as StreamStatistics
    from runtime.streams.stream_counter import MessageCounts as MessageCounts
    from runtime.streams.stream_counter import StreamCounter as StreamCounter
    from runtime.streams.stream_counter import StreamCounts as StreamCounts
    from runtime.streams.stream_counter import WatchdogLevel as WatchdogLevel
    from runtime.streams.stream_counter import WatchdogLimits as WatchdogLimits
    from runtime.streams.stream_counter import WatchdogState as WatchdogState
    from runtime.streams.stream_thread import MonotonicClock as MonotonicClock

    __version__: str

# Module -> its public names.
_MODULES = {
    "alignment.calibrate": "CalibrationResult Verdict calibrate",
    "alignment.fit_scores": "FitScores",
    "base.errors": "ContractError InferenceError InputError OutputError ProviderError SSDNetError",
    "contract.canonical_focal": "CameraScale",
    "contract.contract": "ClassInfo Contract ModelContent",
    "engine.bundled_models": "list_bundled_models",
    "engine.prediction": "Cleaned HeadArrays Latency Prediction",
    "engine.predictor": "Predictor",
    "geometry.assumptions": "AssumptionWarning",
    "geometry.calibration": "Calibration",
    "geometry.lens": "Lens",
    "geometry.motion": "CompensatedDepth Scan",
    "geometry.point_cloud": "PointCloud",
    "geometry.poses": "PoseFrame PoseTrack",
    "geometry.projection": "project_points",
    "geometry.rig": "Rig",
    "recordings.registry": "open_source",
    "recordings.ros_answers": "FixedTransform SensorFrames",
    "recordings.source": "ListedFrame Source",
    "streams.answerer": "FramePredictor",
    "streams.frame": "Frame Message Outcome Sensor",
    "streams.frame_result": "FrameResult",
    "streams.health.consistency": "Consistency",
    "streams.push_stream": "PushStream",
    "streams.replay": "ReplayMessage replay",
    "streams.statistics": "LatencyStatistics MissedDeadlines StreamStatistics",
    "streams.stream_counter": "MessageCounts StreamCounter StreamCounts "
    "WatchdogLevel WatchdogLimits WatchdogState",
    "streams.stream_thread": "MonotonicClock",
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
