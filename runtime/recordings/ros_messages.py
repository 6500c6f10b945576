"""Arrays from deserialised ROS sensor messages; their layouts are those of sensor_msgs.

Every function takes a message with the fields of its type. If the fields are inconsistent it raises
InputError before it allocates memory.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import cut, shown
from runtime.base.errors import InputError
from runtime.geometry.returns import to_metres
from runtime.recordings.images import decode_rgb, require_pixels

# Number of channels and conversion to RGB for each encoding of an image.
_PICTURES: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
MONO16 = "mono16"
# Type and units per metre for each encoding of a depth map (REP 118); some drivers write mono16.
DEPTHS: dict[str, tuple[str, float]] = {
    "16UC1": ("u2", 1000.0),
    "32FC1": ("f4", 1.0),
    MONO16: ("u2", 1000.0),
}
# Datatypes of a PointField that a coordinate may have.
_FLOATS = {7: "f4", 8: "f8"}


def decode_image(message: Any) -> NDArray[np.uint8]:
    """Decode an Image.

    Args:
        message: sensor_msgs/Image in rgb8, bgr8, rgba8, bgra8, mono8 or bayer_*8.

    Returns:
        uint8 (H, W, 3), RGB.

    Raises:
        InputError: if the encoding is another one or the fields are inconsistent.
    """
    encoding = message.encoding
    if encoding not in _PICTURES:
        hint = "expected one of " + ", ".join(_PICTURES)
        if encoding in DEPTHS:
            hint = "if that is a depth map, name it by `depth_topic=`"
        raise InputError(f"an Image has the encoding {shown(encoding)}: {hint}")
    channels, conversion = _PICTURES[encoding]
    pixels = np.ascontiguousarray(_pixels(message, np.dtype("u1"), channels))
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def decode_compressed_image(message: Any) -> NDArray[np.uint8]:
    """Decode a CompressedImage.

    Args:
        message: sensor_msgs/CompressedImage with an 8-bit JPEG or PNG. An image of one channel
            whose format names bayer_*8 is a mosaic.

    Returns:
        uint8 (H, W, 3), RGB.

    Raises:
        InputError: if the format is another one or the content is damaged.
    """
    # image_transport writes "ENCODING; jpeg compressed TARGET"; others write "jpeg".
    encoding, name = str(message.format).split(";")[0].strip(), shown(message.format)
    is_depth = encoding in DEPTHS and encoding != MONO16
    if is_depth or "compressedDepth" in str(message.format):
        raise InputError(
            f"a CompressedImage has the format {name}, a depth map: republish it as raw, for "
            "`depth_topic=`"
        )
    content = bytes(memoryview(message.data))
    rgb = decode_rgb(content, name=f"a CompressedImage ({name})")
    if not encoding.startswith("bayer_") or (rgb != rgb[..., :1]).any():
        return rgb  # the camera's colours, also if a mosaic was converted before
    height, width, mosaic = *rgb.shape[:2], rgb[..., 0].ravel()
    fields = {"encoding": encoding, "height": height, "width": width, "step": width}
    return decode_image(SimpleNamespace(**fields, data=mosaic))


def decode_depth_image(message: Any) -> NDArray[np.float32]:
    """Decode a depth Image.

    Args:
        message: sensor_msgs/Image in 16UC1 or mono16 [mm], or 32FC1 [m].

    Returns:
        float32 (H, W), metres. 0, values that are not finite and 65535 are no measurement.

    Raises:
        InputError: if the encoding is another one or the fields are inconsistent.
    """
    encoding = message.encoding
    if encoding not in DEPTHS:
        raise InputError(
            f"a depth Image has the encoding {shown(encoding)}: expected 16UC1 or mono16 [mm], "
            "or 32FC1 [m]"
        )
    kind, units_a_metre = DEPTHS[encoding]
    order = ">" if message.is_bigendian else "<"
    pixels = _pixels(message, np.dtype(order + kind), 1)
    return to_metres(pixels, units_a_metre)


def decode_points(message: Any) -> NDArray[np.float32]:
    """Decode a PointCloud2.

    Args:
        message: sensor_msgs/PointCloud2 with x, y, z in float32 or float64.

    Returns:
        float32 (N, 3), x, y, z in metres; NaN if there is no return.

    Raises:
        InputError: if x, y or z is missing, occurs twice or has another type, or if offsets, steps
            and the length of the data are inconsistent.
    """
    fields = []
    for axis in "xyz":
        of_axis = [field for field in message.fields if field.name == axis]
        if len(of_axis) != 1:
            names = cut(", ".join(str(field.name) for field in message.fields), 200) or "none"
            raise InputError(f"a PointCloud2 must have one field {axis}, it has {names}")
        fields += of_axis
    cloud = view_fields(message, fields, _FLOATS)
    with np.errstate(over="ignore", invalid="ignore"):  # Inf beyond float32 is no return
        columns = [cloud[axis].astype(np.float32) for axis in "xyz"]
    return np.stack(columns, axis=-1).reshape(-1, 3)


def view_fields(message: Any, fields: list[Any], types: Mapping[int, str]) -> NDArray[Any]:
    """View fields of a PointCloud2 by their names.

    Args:
        message: sensor_msgs/PointCloud2.
        fields: some of its fields.
        types: the datatypes that they may have, and NumPy's type of each.

    Returns:
        A structured array (height, width).

    Raises:
        InputError: if a field has another datatype, holds several numbers or ends beyond the point,
            or if the data are truncated.
    """
    height, width, point_step = message.height, message.width, message.point_step
    what = f"a PointCloud2 of {height} x {width} points"
    formats, offsets = list[str](), list[int]()
    for field in fields:
        if field.datatype not in types or field.count not in (0, 1):  # some drivers write 0
            raise InputError(
                f"the field {field.name} of a PointCloud2 is {field.count} of the datatype "
                f"{field.datatype}, expected one of {', '.join(types.values())}"
            )
        formats.append((">" if message.is_bigendian else "<") + types[field.datatype])
        offsets.append(field.offset)
        if offsets[-1] + np.dtype(formats[-1]).itemsize > point_step:
            raise InputError(
                f"the field {field.name} of {what} begins at byte {offsets[-1]} of {point_step}: "
                "the message is truncated or inconsistent"
            )
    names = [field.name for field in fields]
    data, row_step = _rows(message, what, height, width * point_step, "row_step")
    layout: np.dtype[Any] = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    )
    return np.ndarray((height, width), layout, data, strides=(row_step, point_step))


def _pixels(message: Any, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """A view of an Image's data, (H, W) or (H, W, channels)."""
    height, width = message.height, message.width
    what = f"an Image of {height} x {width} pixels of {message.encoding}"
    if height == 0 or width == 0:
        raise InputError(f"{what} is empty")
    require_pixels((height, width), name=what)
    pixel = dtype.itemsize * channels
    data, step = _rows(message, what, height, width * pixel, "step")
    shape, strides = (height, width, channels), (step, pixel, dtype.itemsize)
    rank = 2 if channels == 1 else 3
    return np.ndarray(shape[:rank], dtype, data, strides=strides[:rank])


def _rows(
    message: Any, what: str, height: int, row_bytes: int, step: str
) -> tuple[NDArray[np.uint8], int]:
    """The data of a message, not copied, and the bytes from one row to the next.

    Data that are exactly as long as all rows have no padding, whatever step a driver states.
    """
    content = np.frombuffer(message.data, np.uint8)
    is_packed = height <= 1 or len(content) == height * row_bytes
    stride = row_bytes if is_packed else getattr(message, step)
    if stride < row_bytes:
        raise InputError(f"{what} has {step} {stride}, expected at least {row_bytes}")
    needed = stride * (height - 1) + row_bytes
    if len(content) < needed:
        raise InputError(f"{what} has {len(content)} bytes, expected {needed}: it is truncated")
    return content, stride
