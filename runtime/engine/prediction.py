"""The result of `Predictor.predict`."""

import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import NDArray

from runtime.base.arrays import Float32, Floats, Size, UInt8
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_RETURN_M, Contract

if TYPE_CHECKING:
    from runtime.geometry.calibration import Calibration
    from runtime.geometry.point_cloud import PointCloud


@dataclass(frozen=True)
class Latency:
    """Times of one prediction by the monotonic clock, in milliseconds."""

    preprocess_ms: float  # checking, cleaning and resizing the inputs
    inference_ms: float  # the session
    postprocess_ms: float  # checking and resizing the outputs
    total_ms: float


def ms_since(started: float) -> float:
    """Return the milliseconds since a time of `time.perf_counter`."""
    return (time.perf_counter() - started) * 1e3


@dataclass(frozen=True)
class Cleaned:
    """Numbers of depth pixels that were changed, and of points that were left out.

    The first three kinds of pixels were set to 0.
    """

    nan: int = 0  # also 65535 in 16 bits, which marks pixels without a measurement
    infinite: int = 0
    negative: int = 0
    too_far: int = 0  # clipped to the range; set to 0 beyond `farthest_return`
    lost_points: int = 0  # points that are no returns, see `is_return`, or have no valid time

    @property
    def total(self) -> int:
        """The sum of all kinds."""
        return sum(astuple(self))


class HeadArrays:
    """Arrays by head, each of the frame's size (H, W), and one property for each of our heads.

    Attributes:
        heads: head -> array, in the type and unit of its row in `runtime.contract.heads.HEADS`.
    """

    heads: Mapping[str, NDArray[Any]]

    @property
    def semantic(self) -> UInt8 | None:
        """Class ids, uint8 (H, W), see `Contract.classes`; None without that head."""
        return self.heads.get("semantic")

    @property
    def depth(self) -> Float32 | None:
        """Metres along the optical axis, float32 (H, W); None without that head."""
        return self.heads.get("depth")

    @property
    def boundary(self) -> Float32 | None:
        """Probability 0..1 of a boundary between classes, float32 (H, W); None without it."""
        return self.heads.get("boundary")

    @property
    def depth_uncertainty(self) -> Float32 | None:
        """Scale b [m] of a Laplace distribution around `depth`, float32 (H, W); None without it.

        63 % of the errors are meant to lie within b, 86 % within 2 b.
        """
        return self.heads.get("depth_uncertainty")

    @property
    def semantic_logits(self) -> Float32 | None:
        """Class scores, float32 (C, H, W); None unless the model was exported with them."""
        return self.heads.get("semantic_logits")


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(HeadArrays):
    """The answers for one frame, at the frame's own size (H, W). The arrays belong to the caller.

    Attributes:
        heads: head -> answer, for each head of the model, see `runtime.contract.heads`.
        frame_size: (height, width).
        network_size: (height, width) at which the network ran; the answers are resized to the
            frame's size.
        latency: times of the stages.
        valid: False if an output holds NaN, Inf, an unknown class or a value out of its range;
            `degraded` then has the reason.
        degraded: reasons why the answer is less reliable than usual; () in the normal case.
        cleaned: numbers of depth pixels that were changed, and of points that were left out.
        depth_returns: number of depth pixels used.
        range_m: depth range of the frame in metres; no answer is farther.
        stamp: the stamp that was given to `predict`.
        contract: contract of the model that answered; None in a prediction made by hand.
    """

    heads: Mapping[str, NDArray[Any]]
    frame_size: Size
    network_size: Size
    latency: Latency
    valid: bool = True
    degraded: tuple[str, ...] = ()
    cleaned: Cleaned = field(default_factory=Cleaned)
    depth_returns: int = 0
    range_m: float = MAX_RETURN_M
    stamp: Any = None
    contract: Contract | None = None

    def __repr__(self) -> str:
        height, width = self.frame_size
        heads = ", ".join(self.heads)
        doubts = "".join(f", {reason}" for reason in self.degraded)
        return (
            f"Prediction({heads}; {height} x {width}; {self.latency.total_ms:.1f} ms; "
            f"{'valid' if self.valid else 'invalid'}{doubts})"
        )

    def after_reading(self, degraded: tuple[str, ...], lost_points: int) -> "Prediction":
        """Return a copy with reasons added to `degraded`, and with `Cleaned.lost_points`."""
        cleaned = replace(self.cleaned, lost_points=lost_points)
        return replace(self, degraded=(*self.degraded, *degraded), cleaned=cleaned)

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of the classes in the order of the ids of `semantic`; () if none are known."""
        return () if self.contract is None else tuple(each.name for each in self.contract.classes)

    def draw(self, rgb: UInt8 | None = None) -> UInt8:
        """Draw one picture of the frame and its answers.

        Args:
            rgb: uint8 (H, W, 3), the frame's image, RGB; None: draw only the answers.

        Returns:
            uint8 (H', W', 3), RGB: a grid of panels of image and heads with a legend beside them.
            Large frames are shrunk by a whole number to fit a screen of 1920 x 1080 pixels, see
            `runtime.drawing.overlay.Overlay.draw`. Answers whose `valid` is False are
            drawn, too.

        Raises:
            InputError: if the image does not have the frame's size, or `contract` is None.
        """
        from runtime.engine.draw_prediction import draw_prediction  # on demand

        return draw_prediction(self, rgb)

    def save(
        self,
        path: "str | PathLike[str]",
        rgb: UInt8 | None = None,
        *,
        intrinsics: "Floats | Calibration | None" = None,
    ) -> None:
        """Write the prediction to a file; an existing file is replaced after a complete write.

        Args:
            path: its ending decides the format. `.png`, `.jpg` and `.jpeg` hold the picture of
                `draw`. `.npz` holds all arrays under their head's name, with `valid` and
                `degraded`. `.ply` holds the cloud of `points`, binary, with colours if `rgb` is
                given and class ids as `label`.
            rgb: uint8 (H, W, 3), the frame's image, RGB.
            intrinsics: see `points`; needed for `.ply`.

        Raises:
            InputError: for another ending, and as for `draw` and `points`.
            OutputError: if the file cannot be written.
        """
        from runtime.engine.draw_prediction import save_prediction  # on demand

        save_prediction(self, path, rgb, intrinsics=intrinsics)

    def points(
        self,
        intrinsics: "Floats | Calibration",
        rgb: UInt8 | None = None,
        *,
        edge_boundary: float | Literal["auto"] | None = "auto",
        keep_sky: bool = False,
        max_uncertainty: float | None = None,
        voxel_m: float | None = None,
    ) -> "PointCloud":
        """Return the depth as a point cloud in the camera's frame, labelled with `semantic`.

        Args:
            intrinsics: the camera's `Calibration`, or float (3, 3) of a rectified camera, in pixels
                of the frame.
            rgb: uint8 (H, W, 3), the frame's image, for the colours of the points.
            edge_boundary: pixels whose `boundary` is larger have no point, because depth passes
                from one surface to the next there. "auto" = 0.25 with classes, 0.5 without;
                None: no pixel is left out for this reason.
            keep_sky: keep the points of the class "sky", whose depth is meaningless.
            max_uncertainty: pixels whose `depth_uncertainty` is a larger share of their depth have
                no point; None: no pixel is left out for this reason.
            voxel_m: side of cubes in metres; of each cube, only the point of the smallest
                uncertainty is kept. None: all points are kept.

        Raises:
            InputError: if an array does not fit, a value is out of range, `valid` is False, the
                model has no depth, or `max_uncertainty` is given and the model has no
                `depth_uncertainty`.
        """
        if self.depth is None or not self.valid:
            reason = ", ".join(self.degraded) if self.depth is not None else "it has no such head"
            raise InputError(f"the prediction has no usable depth: {reason}")
        # Imported on demand: most programs make no clouds.
        from runtime.geometry.calibration import Calibration
        from runtime.geometry.point_cloud import depth_to_cloud, thin_to_voxels

        lens = None
        if isinstance(intrinsics, Calibration):
            intrinsics.require_size(self.depth.shape)
            lens, intrinsics = intrinsics.lens_model, intrinsics.intrinsics
        cloud = depth_to_cloud(
            self.depth,
            intrinsics,
            lens=lens,
            rgb=rgb,
            semantic=self.semantic,
            boundary=self.boundary,
            uncertainty=self.depth_uncertainty,
            edge_boundary=edge_boundary,
            max_uncertainty=max_uncertainty,
            sky=None if keep_sky or self.contract is None else self.contract.sky,
        )
        return cloud if voxel_m is None else thin_to_voxels(cloud, voxel_m)
