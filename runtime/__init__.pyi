"""The public names and where they are defined; `__init__.py` loads each on first use."""

from runtime.alignment.calibrate import (
    CalibrationResult as CalibrationResult,
)
from runtime.alignment.calibrate import (
    Verdict as Verdict,
)
from runtime.alignment.calibrate import (
    calibrate as calibrate,
)
from runtime.alignment.fit_scores import FitScores as FitScores
from runtime.base.errors import (
    ContractError as ContractError,
)
from runtime.base.errors import (
    InferenceError as InferenceError,
)
from runtime.base.errors import (
    InputError as InputError,
)
from runtime.base.errors import (
    OutputError as OutputError,
)
from runtime.base.errors import (
    ProviderError as ProviderError,
)
from runtime.base.errors import (
    SSDNetError as SSDNetError,
)
from runtime.contract.canonical_focal import CameraScale as CameraScale
from runtime.contract.contract import (
    ClassInfo as ClassInfo,
)
from runtime.contract.contract import (
    Contract as Contract,
)
from runtime.contract.contract import (
    ModelContent as ModelContent,
)
from runtime.engine.bundled_models import list_bundled_models as list_bundled_models
from runtime.engine.prediction import (
    Cleaned as Cleaned,
)
from runtime.engine.prediction import (
    HeadArrays as HeadArrays,
)
from runtime.engine.prediction import (
    Latency as Latency,
)
from runtime.engine.prediction import (
    Prediction as Prediction,
)
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
from runtime.recordings.ros_answers import (
    FixedTransform as FixedTransform,
)
from runtime.recordings.ros_answers import (
    SensorFrames as SensorFrames,
)
from runtime.recordings.source import ListedFrame as ListedFrame
from runtime.recordings.source import Source as Source
from runtime.streams.answerer import FramePredictor as FramePredictor
from runtime.streams.frame import (
    Frame as Frame,
)
from runtime.streams.frame import (
    Message as Message,
)
from runtime.streams.frame import (
    Outcome as Outcome,
)
from runtime.streams.frame import (
    Sensor as Sensor,
)
from runtime.streams.frame_result import FrameResult as FrameResult
from runtime.streams.health.consistency import Consistency as Consistency
from runtime.streams.push_stream import PushStream as PushStream
from runtime.streams.replay import ReplayMessage as ReplayMessage
from runtime.streams.replay import replay as replay
from runtime.streams.statistics import (
    LatencyStatistics as LatencyStatistics,
)
from runtime.streams.statistics import (
    MissedDeadlines as MissedDeadlines,
)
from runtime.streams.statistics import (
    StreamStatistics as StreamStatistics,
)
from runtime.streams.stream_counter import (
    MessageCounts as MessageCounts,
)
from runtime.streams.stream_counter import (
    StreamCounter as StreamCounter,
)
from runtime.streams.stream_counter import (
    StreamCounts as StreamCounts,
)
from runtime.streams.stream_counter import (
    WatchdogLevel as WatchdogLevel,
)
from runtime.streams.stream_counter import (
    WatchdogLimits as WatchdogLimits,
)
from runtime.streams.stream_counter import (
    WatchdogState as WatchdogState,
)
from runtime.streams.stream_thread import MonotonicClock as MonotonicClock

__version__: str
