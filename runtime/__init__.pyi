"""The public names and where they are defined; `__init__.py` loads each on first use."""

from runtime.alignment.calibrate import (
    CalibrationResult as CalibrationResult,
    Verdict as Verdict,
    calibrate as calibrate,
)
from runtime.alignment.fit_scores import FitScores as FitScores
from runtime.base.errors import (
    CheckpointError as CheckpointError,
    ContractError as ContractError,
    DatasetError as DatasetError,
    InferenceError as InferenceError,
    InputError as InputError,
    OutputError as OutputError,
    ProviderError as ProviderError,
    SSDNetError as SSDNetError,
)
from runtime.contract.canonical_focal import CameraScale as CameraScale
from runtime.contract.contract import (
    ClassInfo as ClassInfo,
    Contract as Contract,
    ModelContent as ModelContent,
)
from runtime.engine.bundled_models import list_bundled_models as list_bundled_models
from runtime.engine.prediction import (
    Cleaned as Cleaned,
    HeadArrays as HeadArrays,
    Latency as Latency,
    Prediction as Prediction,
)
from runtime.engine.predictor import Predictor as Predictor
from runtime.geometry.assumptions import AssumptionWarning as AssumptionWarning
from runtime.geometry.calibration import Calibration as Calibration
from runtime.geometry.lens import Lens as Lens
from runtime.geometry.point_cloud import PointCloud as PointCloud
from runtime.geometry.poses import PoseFrame as PoseFrame, PoseTrack as PoseTrack
from runtime.geometry.projection import project_points as project_points
from runtime.geometry.rig import Rig as Rig
from runtime.recordings.registry import open_source as open_source
from runtime.recordings.ros_answers import (
    FixedTransform as FixedTransform,
    SensorFrames as SensorFrames,
)
from runtime.recordings.source import ListedFrame as ListedFrame, Source as Source
from runtime.streams.answerer import FramePredictor as FramePredictor
from runtime.streams.frame import (
    CompensatedDepth as CompensatedDepth,
    Frame as Frame,
)
from runtime.streams.frame_result import FrameResult as FrameResult
from runtime.checks.consistency import Consistency as Consistency
from runtime.streams.messages import (
    Depth as Depth,
    Image as Image,
    Outcome as Outcome,
    Pose as Pose,
    Scan as Scan,
    Sensor as Sensor,
)
from runtime.streams.push_stream import PushStream as PushStream
from runtime.streams.replay import ReplayMessage as ReplayMessage, replay as replay
from runtime.streams.statistics import (
    LatencyStatistics as LatencyStatistics,
    MissedDeadlines as MissedDeadlines,
    StreamStatistics as StreamStatistics,
)
from runtime.streams.stream_counter import (
    MessageCounts as MessageCounts,
    StreamCounter as StreamCounter,
    StreamCounts as StreamCounts,
    WatchdogLevel as WatchdogLevel,
    WatchdogLimits as WatchdogLimits,
    WatchdogState as WatchdogState,
)
from runtime.streams.stream_thread import MonotonicClock as MonotonicClock

__version__: str
