"""Pictures and depth maps of the same names in two folders."""

from pathlib import Path
from typing import Any

from runtime.io.calibration import Calibration
from runtime.io.images import KITTI_DEPTH_SCALE, list_pictures, natural_order, read_rgb
from runtime.sources.frames import Frame, FrameFiles, list_frames, read_frame
from runtime.sources.source import ListedFrame, Source, no_depth, up_to


class FolderSource(Source):
    """Pairs of files with the same stem, in natural order.

    rgb: folder of PNG and JPEG files
    depth: folder of 16-bit PNGs; None = the camera alone, on purpose
    depth_scale: their units a metre
    calibration: TOML or KITTI file, see `Calibration.from_file`
    """

    def __init__(
        self,
        rgb: Path,
        *,
        depth: Path | None = None,
        depth_scale: float = KITTI_DEPTH_SCALE,
        calibration: Path | None = None,
    ) -> None:
        self._rgb, self._depth, self._depth_scale = rgb, depth, depth_scale
        self.folders = (rgb,) if depth is None else (rgb, depth)
        if calibration is not None:
            self.calibration = Calibration.from_file(calibration)

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A name without a partner is listed too."""
        if self._depth is None:
            pictures = list_pictures(self._rgb)
            names = sorted(pictures, key=natural_order)
            return up_to(
                (ListedFrame(i, name, pictures[name], None) for i, name in enumerate(names)), limit
            )
        return tuple(
            ListedFrame(i, files.name, files.rgb, files.sparse_depth, complete=files.complete)
            for i, files in enumerate(list_frames(self._rgb, self._depth, limit=limit))
        )

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where one of the two files is missing."""
        if self._depth is None:
            rgb = read_rgb(frame.image)
            return Frame(rgb, no_depth(rgb), calibration=self.calibration)
        files = FrameFiles(frame.name, frame.image, frame.depth)
        read = read_frame(files, depth_scale=self._depth_scale)
        return Frame(read.rgb, read.sparse_depth, calibration=self.calibration)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        depth = None if self._depth is None else str(self._depth)
        return {"rgb": str(self._rgb), "depth": depth, "depth_scale": self._depth_scale}
