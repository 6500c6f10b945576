"""Reading images and depth maps from files of bounded size."""

import contextlib
import io
import re
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import cut
from runtime.base.errors import InputError
from runtime.base.natural_order import normal_form
from runtime.contract.contract import MAX_PIXELS
from runtime.files.read_input import read_input
from runtime.geometry.returns import to_metres
from runtime.recordings.orientation import check_exif

RGB_SUFFIXES = (".png", ".jpg", ".jpeg")
DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy")
KITTI_DEPTH_SCALE = 256.0  # units per metre; Virtual KITTI uses 100
# Words in the names of topics and folders whose pictures are neither in colour nor depth, although
# they have 16 bits or floats. Those of infrared cameras count unless "depth" is a word, too; the
# others name what is measured or computed beside depth.
_INFRARED = re.compile(
    r"(?<![a-z])((|n|sw|mw|lw)ir|(infra|therm|nearir|flir|lepton|boson)[a-z]*)(?![a-z])"
)
_NOT_DEPTH = re.compile(
    r"(?<![a-z])(amplitude|intensity|confidence|signal|uncertainty|variance|flow|"
    r"(reflec|disparity|semantic|segment|label|instance)[a-z]*)(?![a-z])"
)
_PNG_START = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
_JPEG_START = b"\xff\xd8"
# Codes of JPEG markers (ITU-T T.81, table B.1). A marker is the byte 0xFF followed by its code.
_MARKER = re.compile(rb"\xff([^\x00\xff])")
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NO_SEGMENT = frozenset({0x01, *range(0xD0, 0xD8)})
_MAX_SEGMENTS = 1000  # segments before the one with the size; a colour profile takes up to 255


def may_be_depth(name: str) -> bool:
    """Return whether the images of a topic or folder may be depth or a colour image, by name."""
    name = name.lower()
    if _NOT_DEPTH.search(name):
        return False
    return "depth" in re.split("[^a-z]", name) or not _INFRARED.search(name)


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit PNG or JPEG file.

    A single channel is repeated three times. Pixels stay where the sensor has them, as they do in
    the depth map: an EXIF orientation is reported as an assumption, but not applied. A JPEG that is
    complete but damaged inside is decoded as far as possible, because its format has no checksum;
    PNG has one.

    Args:
        path: the file, of at most `MAX_FILE_BYTES` and `MAX_PIXELS`.

    Returns:
        uint8 (H, W, 3), RGB.

    Raises:
        InputError: if the file cannot be read, is truncated or damaged, or has more than 8 bits per
            channel.
    """
    return decode_rgb(read_input(path), name=str(path))


def decode_rgb(content: bytes, *, name: str) -> NDArray[np.uint8]:
    """Decode the content of a PNG or JPEG file as `read_rgb` does; errors mention `name`."""
    content = check_exif(content, "images")
    image = decode(content, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_ANYDEPTH, name=name)
    if image.dtype != np.uint8:
        raise InputError(
            f"{name} must hold 8 bits a channel, got {image.dtype.itemsize * 8} bits: is it a "
            "depth map? Convert an image of more bits"
        )
    return image


def read_sparse_depth(path: Path, *, depth_scale: float = KITTI_DEPTH_SCALE) -> NDArray[np.float32]:
    """Read a depth map from a PNG, TIFF or .npy file.

    Args:
        path: the file, of at most `MAX_FILE_BYTES` and `MAX_PIXELS`, with one channel of uint16, or
            of floats in metres.
        depth_scale: units of uint16 per metre: 256 for KITTI, 100 for Virtual KITTI.

    Returns:
        float32 (H, W), metres. 0, values that are not finite and 65535 are no measurement.

    Raises:
        InputError: if the file cannot be read, is truncated or damaged, or holds anything else.
    """
    depth = _read_map(path)
    kind = depth.dtype.str[1:]
    if depth.ndim != 2 or not (kind == "u2" or kind.startswith("f")):
        is_picture = depth.dtype == np.uint8
        remedy = "an 8-bit image does not contain metres" if is_picture else "convert it to one"
        raise InputError(
            f"{path} must be a depth map of one channel of 16 bits (PNG, TIFF or .npy) or of "
            f"floats in metres (TIFF or .npy), got {depth.dtype} {depth.shape}: {remedy}"
        )
    return to_metres(depth, depth_scale if kind == "u2" else 1)


def is_in_metres(path: Path) -> bool:
    """Whether a depth map holds floats, which are metres. Raises InputError."""
    return path.suffix.lower() != ".png" and _read_map(path).dtype.kind == "f"


def _read_map(path: Path) -> NDArray[Any]:
    if path.suffix.lower() == ".npy":
        return read_npy(path)
    content = check_exif(read_input(path), "depth maps")
    return decode(content, cv2.IMREAD_UNCHANGED, name=str(path))


def read_npy(path: Path) -> NDArray[Any]:
    """Read a .npy file of at most `MAX_FILE_BYTES`.

    Raises:
        InputError: if the file cannot be read, is truncated or damaged, or holds Python objects.
    """
    file = io.BytesIO(read_input(path))
    try:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    except Exception as error:  # parsing the header, a Python expression, may raise any type
        raise InputError(
            f"{path} is not a .npy file of numbers, or is truncated ({cut(str(error), 200)})"
        ) from error
    return array


def decode(content: bytes, flags: int, *, name: str) -> NDArray[Any]:
    """Decode a PNG, JPEG or TIFF with OpenCV's IMREAD_* `flags`. Raises InputError.

    Pixels stay as they are stored, but those of a TIFF only after `check_exif`.
    """
    if (size := image_size(content)) is not None:
        require_pixels(size, name=name)  # checked before the pixels take memory
    try:
        image: NDArray[Any] | None = cv2.imdecode(
            np.frombuffer(content, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{name} is empty, truncated or damaged, or not a PNG, JPEG or TIFF")
    require_pixels((image.shape[0], image.shape[1]), name=name)
    return image


def image_size(content: bytes) -> tuple[int, int] | None:
    """(height, width) from the header of a PNG or JPEG file; None for any other content.

    The size is read at the place where OpenCV's decoders (libpng, libjpeg) read it.
    """
    with contextlib.suppress(struct.error):  # the content may be truncated
        if content.startswith(_PNG_START):
            width, height = struct.unpack_from(">II", content, len(_PNG_START))
            return height, width
        if content.startswith(_JPEG_START):
            return _jpeg_size(content)
    return None


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    position = len(_JPEG_START)
    for _ in range(_MAX_SEGMENTS):
        marker = _MARKER.search(content, position)
        if marker is None:
            return None
        position = marker.end()
        if marker[1][0] in _START_OF_FRAME:
            _length, _precision, height, width = struct.unpack_from(">HBHH", content, position)
            return height, width
        if marker[1][0] not in _NO_SEGMENT:
            position += struct.unpack_from(">H", content, position)[0]
    return None


def require_pixels(size: tuple[int, int], *, name: str) -> None:
    """Raise InputError for an image size (height, width) of more than `MAX_PIXELS` pixels."""
    height, width = size
    if height * width > MAX_PIXELS:
        raise InputError(f"{name} has {height} x {width} pixels, expected at most {MAX_PIXELS:,}")


def list_files(folder: Path, suffixes: tuple[str, ...] = RGB_SUFFIXES) -> dict[str, Path]:
    """Map the stems of the files in a folder that end in one of `suffixes` to their paths.

    Hidden files are left out. The stems have their `normal_form`. Raises InputError if there is no
    such file, if the folder cannot be listed, or if a stem occurs twice.
    """
    try:
        paths = sorted(folder.iterdir())
    except (OSError, ValueError) as error:  # a zero byte in the name raises ValueError
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot list the folder {cut(str(folder), 200)} ({reason})") from error
    files: dict[str, Path] = {}
    for path in paths:
        suffix = next(filter(path.name.lower().endswith, suffixes), None)
        if suffix is None or path.name.startswith("."):
            continue
        stem = normal_form(path.name[: -len(suffix)])
        if stem in files:
            raise InputError(f"{files[stem]} and {path} have the same stem: remove one")
        files[stem] = path
    if not files:
        others = {path.suffix for path in paths if path.suffix and path.name[0] != "."}
        raise InputError(
            f"the folder {folder} has no {' or '.join(suffixes)} files, it has "
            f"{', '.join(sorted(others)[:5]) or 'other'} files: give another folder or option"
        )
    return files
