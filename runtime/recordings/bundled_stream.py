"""The short stream of rendered frames that is installed with the engine."""

from importlib import resources
from pathlib import Path

from runtime.base.errors import InputError
from runtime.recordings.folders import FolderSource
from runtime.streams.frame import Frame

# Focal length [px] of the stream's camera: KITTI's 721.54 px at 1242 columns, rendered with 832.
BUNDLED_FOCAL_LENGTH_PX = 721.54 * 832 / 1242


def bundled_stream() -> tuple[Path, Path]:
    """Return the folders of its images and of its sparse depth maps. Raises InputError."""
    stream = Path(str(resources.files("runtime"))) / "assets" / "stream"
    if not stream.is_dir():
        raise InputError(f"the bundled stream {stream} is missing: install ssdnet again")
    return stream / "rgb", stream / "depth"


def bundled_frames() -> list[Frame]:
    """Read the frames of the stream in their order. Raises InputError."""
    rgb, depth = bundled_stream()
    source = FolderSource(rgb, depth=depth)
    return [source.read(listed) for listed in source.list_frames()]
