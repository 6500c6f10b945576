"""The public names and where they are defined; `__init__.py` loads each on first use."""

from runtime.alignment.calibrate import (
    CalibrationResult as CalibrationResult,
    Verdict as Verdict,
    calibrate as calibrate,
)
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
from runtime.checks.finding import Finding as Finding, Severity as Severity
from runtime.checks.fit import FitScores as FitScores
from runtime.checks.judge import Judgement as Judgement
from runtime.contract.canonical_focal import CameraScale as CameraScale
from runtime.contract.contract import (
    ClassInfo as ClassInfo,
    Contract as Contract,
    ModelContent as ModelContent,
)
from runtime.contract.heads import (
    HEADS as HEADS,
    Difference as Difference,
    Head as Head,
    Panel as Panel,
    Unit as Unit,
)
from runtime.contract.resize import move_returns as move_returns
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
from runtime.geometry.odometry import Odometry as Odometry
from runtime.geometry.point_cloud import PointCloud as PointCloud
from runtime.geometry.poses import PoseFrame as PoseFrame, PoseTrack as PoseTrack
from runtime.geometry.projection import project_points as project_points
from runtime.geometry.rig import Rig as Rig
from runtime.recordings.bundled_stream import (
    BUNDLED_FOCAL_LENGTH_PX as BUNDLED_FOCAL_LENGTH_PX,
    bundled_frames as bundled_frames,
)
from runtime.recordings.images import read_rgb as read_rgb
from runtime.recordings.listing import ListedFrame as ListedFrame
from runtime.recordings.registry import choose_source as choose_source, open_source as open_source
from runtime.recordings.ros_answers import (
    FixedTransform as FixedTransform,
    SensorFrames as SensorFrames,
    camera_fields as camera_fields,
    cloud_fields as cloud_fields,
    status_fields as status_fields,
)
from runtime.recordings.ros_poses import (
    odometry_pose as odometry_pose,
    point_times_s as point_times_s,
)
from runtime.recordings.scan import read_scan as read_scan
from runtime.recordings.source import Source as Source
from runtime.streams.answerer import FramePredictor as FramePredictor
from runtime.streams.frame import (
    CompensatedDepth as CompensatedDepth,
    Frame as Frame,
)
from runtime.streams.frame_result import FrameResult as FrameResult
from runtime.checks.consistency import Consistency as Consistency
from runtime.streams.matching import Discarded as Discarded, Pair as Pair
from runtime.streams.messages import (
    Depth as Depth,
    Image as Image,
    Message as Message,
    Outcome as Outcome,
    Pose as Pose,
    Scan as Scan,
    Sensor as Sensor,
)
from runtime.streams.memory import ScanMemory as ScanMemory, Remembered as Remembered
from runtime.streams.push_stream import MonotonicClock as MonotonicClock, PushStream as PushStream
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

__version__: str
