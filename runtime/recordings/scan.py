"""LiDAR scans from files: raw floats as in KITTI and nuScenes, PCD, PLY and .npy.

Formats: PCD 0.7 of the Point Cloud Library, compressed with Marc Lehmann's LZF; Greg Turk, "The PLY
Polygon File Format", 1994.
"""

import contextlib
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import lzf
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import cut, shown
from runtime.base.errors import InputError
from runtime.files.read_input import MAX_FILE_BYTES, read_input
from runtime.geometry.assumptions import assume
from runtime.geometry.returns import is_return, is_transposed
from runtime.recordings.images import read_npy

SCAN_SUFFIXES = (".pcd.bin", ".bin", ".pcd", ".ply", ".npy")  # .pcd.bin before .bin
_MAX_HEADER_BYTES = 100_000
_LAST_LINE = re.compile(rb"^(DATA\s|end_header)[^\n]*\n", re.MULTILINE)
_CODES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
_WORDS = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
# NumPy's types for the types of a field in a PLY or PCD file.
_TYPES = {np.dtype(code).name: code for code in _CODES} | dict(zip(_WORDS, _CODES, strict=True))
_TYPES |= {code: code for code in (*_CODES, "i8", "u8")}
# What the C library of Windows prints for NaN and infinity; neither is a return.
_WORD_OF_WINDOWS = re.compile(rb"-?(?:nan\([a-z]*\)|1\.#[a-z]+[0-9]*)", re.IGNORECASE)
_ASCII, _COMPRESSED = "ascii", "binary_compressed"
# Byte order for each encoding of the points.
_AT_ORIGIN = (0, 0, 0, 1, 0, 0, 0)  # a VIEWPOINT: x, y, z, and a quaternion with w first
_OF_PCD = {_ASCII: "", "binary": "<", _COMPRESSED: "<"}
_OF_PLY = {_ASCII: "", "binary_little_endian": "<", "binary_big_endian": ">"}
# A raw file does not state how many columns a point has. They are judged by the angle between
# successive points of a rotating scanner: 0.2 degrees along a ring and up to 21 between lasers.
# With a wrong number of columns the median is 80 or more.
_COLUMNS = (3, 4, 5, 6, 7, 8)  # the first that fits is suggested; 8: PCL's padded points
_DOUBLES = 0.9  # share of numbers that are float64 and have a value of float32
_MOST_ROWS = 6  # most rows of a .npy with a row for each coordinate
_MAX_TURN_DEGREES = 40
_MAX_DISTANCE_M = 250
_DIAGONAL, _MOST_ON_AXIS = 0.85, 0.25
_JUDGED_POINTS, _LEAST_JUDGED = 2000, 50


class _Header(NamedTuple):
    fields: list[tuple[str, str, int]]  # name, type and count of the numbers of a point
    points: int
    encoding: str
    is_last: bool  # whether nothing follows the points


def read_scan(path: Path | str, *, columns: int | None = None) -> NDArray[np.float32]:
    """Read a scan; the ending of the file's name decides on the format.

    Args:
        path: .pcd or .ply with the float fields x, y and z; .npy of floats (N, 3) or wider, or (3,
            N) to (6, N) as nuScenes' devkit writes them; any other file is raw float32.
        columns: numbers per point of a raw file; None: 5 for .pcd.bin (nuScenes), else 4 (KITTI).

    Returns:
        float32 (N, 3), x, y, z [m] in the LiDAR's frame, see `is_return` for which points are
        returns. A .npy or raw file with more columns, such as KITTI's reflectance, gives a wider
        array.

    Raises:
        InputError: if the file cannot be read, is truncated or damaged, lacks x, y or z, or holds
            numbers that are not points; and if a raw file looks like a scan only with another
            number of columns, or holds one coordinate after the other.
    """
    path = Path(path)
    name = path.name.lower()
    try:
        if name.endswith(".npy"):
            points = _check_array(read_npy(path))
        elif name.endswith((".pcd", ".ply")):
            points = _read_points(read_input(path), is_pcd=name.endswith(".pcd"))
        else:
            columns = columns or (5 if name.endswith(".pcd.bin") else 4)
            points = _read_raw(read_input(path), columns)
    except ValueError as error:
        raise InputError(f"cannot read the scan {path}: {error}") from error
    is_return(points, name=f"the scan {path}")
    return points


def _check_array(array: NDArray[Any]) -> NDArray[np.float32]:
    array = array.T if is_transposed(array.shape) and len(array) <= _MOST_ROWS else array
    is_scan = array.ndim == 2 and array.shape[1] >= 3 and not is_transposed(array.shape)
    if array.dtype.kind != "f" or not is_scan:
        raise ValueError(f"expected floats of (N, 3) or wider, got {array.dtype} {array.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # values beyond float32 are no return
        return np.ascontiguousarray(array, np.float32)


def _read_raw(content: bytes, columns: int) -> NDArray[np.float32]:
    words = np.frombuffer(content, "<u4", len(content) // 8 * 2)
    wide = words.view("<f8")[words[::2] != 0]  # a float32 0 before another number is a float64, too
    with np.errstate(over="ignore", invalid="ignore"):
        if np.count_nonzero(wide.astype(np.float32) == wide) > _DOUBLES * len(wide):
            raise ValueError("its numbers are float64: write them as float32")
    values = np.frombuffer(content, "<f4", len(content) // 4)
    scans = {n: values.reshape(-1, n) for n in {columns, *_COLUMNS} if len(content) % (4 * n) == 0}
    ordered = {n: _is_of_a_scanner(points) for n, points in scans.items()}
    other = next((n for n in _COLUMNS if n != columns and ordered.get(n)), None)
    if columns in scans and (ordered[columns] is not False or not other):
        if ordered[columns] is False and _is_of_a_scanner(values.reshape(columns, -1).T):
            raise ValueError("it holds all x, then all y, ...: write one point after the other")
        return scans[columns].astype(np.float32)
    fault = "do not follow scan lines as" if columns in scans else "are not whole"
    remedy = f": give `point_columns={other}`" if other else ""
    raise ValueError(
        f"its {len(content)} bytes {fault} points of {columns} float32: it is truncated, of "
        f"another format, or has other columns{remedy}"
    )


def _is_of_a_scanner(points: NDArray[np.float32]) -> bool | None:
    """Whether points in the middle lie in rings or sweeps; None if there are too few points."""
    start = max(0, (len(points) - _JUDGED_POINTS) // 2)  # the first points may be sky
    with np.errstate(over="ignore", invalid="ignore"):  # of NaN and infinity
        judged = points[start : start + _JUDGED_POINTS, :3].astype(np.float64)
        distances = np.sqrt(np.einsum("ij,ij->i", judged, judged))
    is_return = np.isfinite(distances) & (distances > 0)
    if np.count_nonzero(is_return) < _LEAST_JUDGED:
        return None
    directions = judged[is_return] / distances[is_return, None]
    cosines = np.einsum("ij,ij->i", directions[1:], directions[:-1])
    is_ordered = np.median(cosines) > math.cos(math.radians(_MAX_TURN_DEGREES))
    is_near = np.median(distances[is_return]) < _MAX_DISTANCE_M
    # Rows of three x (all x, then all y) lie on the diagonal (1, 1, 1), and rows of an intensity
    # and two zeros lie on an axis. Neither is a scan.
    is_spread = np.median(np.abs(directions.sum(axis=1))) < math.sqrt(3) * _DIAGONAL
    is_spread &= np.mean(np.count_nonzero(directions, axis=1) == 1) < _MOST_ON_AXIS
    return bool(is_ordered and is_near and is_spread)


def _read_points(content: bytes, *, is_pcd: bool) -> NDArray[np.float32]:
    """x, y and z of a file with a header. Raises ValueError."""
    last = _LAST_LINE.search(content, 0, _MAX_HEADER_BYTES)
    if last is None:
        raise ValueError("its header has no end: it is truncated or of another format")
    if not is_pcd and not content.startswith(b"ply"):
        raise ValueError("its first line is not 'ply': it is damaged or of another format")
    text, body = content[: last.end()].decode("latin-1"), content[last.end() :]
    words = [line.split() for line in text.split("\n")]
    fields, points, encoding, is_last = (_parse_pcd if is_pcd else _parse_ply)(words)
    encodings = _OF_PCD if is_pcd else _OF_PLY
    if encoding not in encodings:
        expected = ", ".join(encodings)
        raise ValueError(f"its points are {shown(encoding)}, expected one of {expected}")
    places, size = _place(fields)
    if encoding == _COMPRESSED and points > 0:
        body = _decompress(body, points * size)
    lines = list(filter(bytes.strip, body.splitlines())) if encoding == _ASCII else []
    there = len(lines) if encoding == _ASCII else len(body) // size
    # PCL up to 1.8 writes a page of zeros behind the points.
    is_longer = there > points and is_last and encoding != _COMPRESSED
    if not 0 <= points <= there or (is_longer and (lines or body[points * size :].strip(b"\0"))):
        raise ValueError(
            f"its header states {points} points, it has {there}: is it truncated, or is it another "
            "file's header?"
        )
    if points == 0:
        return np.zeros((0, 3), np.float32)
    if encoding == _ASCII:
        columns = [column for column, _, _ in places]
        if b"#" in body or b"(" in body:
            lines = [_WORD_OF_WINDOWS.sub(b"nan", line) for line in lines]
        return np.loadtxt(lines[:points], np.float32, comments=None, usecols=columns, ndmin=2)
    axes = []
    for _, start, code in places:
        # A compressed PCD file stores field by field: all x, then all y, and so on.
        whole, step = (points, int(code[1])) if encoding == _COMPRESSED else (1, size)
        axes.append(np.ndarray(points, encodings[encoding] + code, body, start * whole, (step,)))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack(axes, axis=1, dtype=np.float32, casting="same_kind")


def _parse_pcd(lines: list[list[str]]) -> _Header:
    header = {words[0]: words[1:] for words in lines if words}
    if missing := {"FIELDS", "SIZE", "TYPE", "POINTS"} - header.keys():
        raise ValueError(f"its header lacks {', '.join(sorted(missing))}")
    names = header["FIELDS"]
    counts = map(int, header.get("COUNT", ["1"] * len(names)))
    if tuple(map(float, header.get("VIEWPOINT", _AT_ORIGIN))) != _AT_ORIGIN:
        assume(
            "the points of PCD files are in the frame of the LiDAR, although the VIEWPOINT is not "
            "its origin",
            "if they are not, move them into that frame, and write VIEWPOINT 0 0 0 1 0 0 0",
        )
    types = map("".join, zip(header["TYPE"], header["SIZE"], strict=True))
    fields = [(name, t.lower(), n) for name, t, n in zip(names, types, counts, strict=True)]
    return _Header(fields, int(" ".join(header["POINTS"])), " ".join(header["DATA"]), True)


def _parse_ply(lines: list[list[str]]) -> _Header:
    encoding, elements, fields = "", list[list[str]](), list[tuple[str, str, int]]()
    for words in lines:
        match words:
            case ["format", encoding, *_]:
                pass
            case ["element", *element]:
                elements.append(element)
            case ["property", *types, name] if len(elements) == 1:
                fields.append((name, " ".join(types), 1))
    if not elements or elements[0][:1] != ["vertex"]:
        raise ValueError("its header does not have vertex as its first element")
    return _Header(fields, int(" ".join(elements[0][1:])), encoding, len(elements) == 1)


def _place(fields: list[tuple[str, str, int]]) -> tuple[list[tuple[int, int, str]], int]:
    """(Column, byte offset, type) of x, y and z, and the number of bytes of a point."""
    places: dict[str, tuple[int, int, str]] = {}
    width = size = 0
    for name, kind, count in fields:
        code = _TYPES.get(kind)
        if code is None or count < 0:  # PCL writes padding with a count of 0
            raise ValueError(f"its field {cut(name)} is {count} of {cut(kind)}, expected numbers")
        if name in ("x", "y", "z"):
            if name in places or count != 1 or code[0] != "f":
                raise ValueError(f"expected one float as the field {name}, got {count} of {kind}")
            places[name] = width, size, code
        width, size = width + count, size + count * int(code[1])
    if len(places) < 3:
        names = ", ".join(name for name, _, _ in fields)
        raise ValueError(f"expected the fields x, y and z, it has {cut(names, 200) or 'none'}")
    return [places[axis] for axis in "xyz"], size


def _decompress(body: bytes, size: int) -> bytes:
    """The compressed points of a PCD file. Raises ValueError unless they have `size` bytes."""
    if size > MAX_FILE_BYTES:
        raise ValueError(f"its points take {size:,} bytes, expected at most {MAX_FILE_BYTES:,}")
    packed, unpacked = np.frombuffer(body, "<u4", 2).tolist() if len(body) >= 8 else (0, 0)
    points: bytes | None = None
    if unpacked == size and packed <= len(body) - 8:
        with contextlib.suppress(ValueError):  # raised for a copy of bytes that do not exist
            points = lzf.decompress(body[8 : 8 + packed], size)
    if points is None or len(points) != size:
        raise ValueError("its compressed points are truncated or damaged")
    return points
