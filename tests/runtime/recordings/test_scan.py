"""Files of scans to float32 points."""

import io
import os
import tracemalloc
from pathlib import Path

import lzf
import numpy as np
import pytest

from runtime import InputError
from runtime.geometry.assumptions import collect_assumptions
from runtime.recordings.scan import read_scan

POINTS = np.random.default_rng(0).normal(0, 30, (50, 3)).astype(np.float32)
POINTS[3] = np.nan
POINTS[20:40] = POINTS[20]  # compressed as copies of the first of them


def pcd(data: bytes, encoding: str, n: int = len(POINTS), **lines: str) -> bytes:
    """A PCD file of 3 x uint8, then y, x and z: a point has 15 bytes and 6 columns."""
    header = {"VERSION": "0.7", "FIELDS": "_ y x z", "SIZE": "1 4 4 4", "TYPE": "U F F F"}
    header |= {"COUNT": "3 1 1 1", "WIDTH": str(n), "HEIGHT": "1", "POINTS": str(n)}
    text = "".join(f"{name} {value}\n" for name, value in (header | lines).items() if value)
    return f"# .PCD v0.7\n{text}DATA {encoding}\n".encode() + data


def ply(data: bytes, encoding: str, n: int | str = len(POINTS), header: str = "") -> bytes:
    """A PLY file of red, y, x in double and z, then faces: a point has 17 bytes and 4 columns."""
    vertex = f"element vertex {n}\nproperty uchar red\nproperty float32 y\nproperty double x\n"
    vertex += "property float z\n"
    face = "element face 1\nproperty list uchar int vertex_indices\n"
    text = f"ply\nformat {encoding} 1.0\ncomment x y z\n{header or vertex + face}end_header\n"
    return text.encode() + data


def records(order: str, *fields: tuple[str, str]) -> bytes:
    rows = np.zeros(len(POINTS), [(name, order + code) for name, code in fields])
    for axis, values in zip("xyz", POINTS.T, strict=True):
        rows[axis] = values
    return rows.tobytes()


def lines(columns: str) -> bytes:
    """Text of the points; each letter of `columns` is a coordinate or a 7."""
    rows = [dict(zip("xyz", map(repr, row), strict=True)) for row in POINTS.tolist()]
    return "".join(" ".join(r.get(c, "7") for c in columns) + "\n" for r in rows).encode()


OF_PCD = records("<", ("a", "u1"), ("b", "u1"), ("c", "u1"), ("y", "f4"), ("x", "f4"), ("z", "f4"))
OF_PLY = [("red", "u1"), ("y", "f4"), ("x", "f8"), ("z", "f4")]
FACE = bytes([3]) + bytes(12)


def compressed(more: bytes = b"") -> bytes:
    """Each field after the other, by LZF, with copies of what repeats; `more` is undeclared."""
    fields = bytes(3 * len(POINTS)) + POINTS[:, [1, 0, 2]].T.tobytes() + more
    packed = lzf.compress(fields)
    return np.array([len(packed), len(OF_PCD)], "<u4").tobytes() + packed


NO_BYTE = {"FIELDS": "_ _ y x z", "SIZE": "1 4 4 4 4", "TYPE": "U U F F F"}
FILES = {
    "ascii.pcd": pcd(lines("777yxz"), "ascii"),
    "binary.pcd": pcd(OF_PCD, "binary"),
    "compressed.pcd": pcd(compressed(), "binary_compressed"),
    "ascii.ply": ply(lines("7yxz") + b"3 0 1 2\n", "ascii"),
    "crlf.PLY": ply(lines("7yxz"), "ascii").replace(b"\n", b"\r\n"),
    "little.ply": ply(records("<", *OF_PLY) + FACE, "binary_little_endian"),
    "big.ply": ply(records(">", *OF_PLY) + FACE, "binary_big_endian"),
    "padding of no byte.pcd": pcd(OF_PCD, "binary", **NO_BYTE, COUNT="3 0 1 1 1"),
    "padding of no byte in text.pcd": pcd(lines("777yxz"), "ascii", **NO_BYTE, COUNT="3 0 1 1 1"),
    "a page longer.pcd": pcd(OF_PCD + bytes(4096), "binary"),  # PCL up to 1.8
    "blank lines.pcd": pcd(b"\n \n" + lines("777yxz"), "ascii"),
}
for word in (b"-nan(ind)", b"1.#QNAN", b"-1.#IND00", b"1.#INF", b"nan(snan)"):  # of Windows
    name = word.decode().replace("#", "")
    FILES |= {name + each: FILES["ascii" + each].replace(b"nan", word) for each in (".pcd", ".ply")}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", FILES)
def test_x_y_and_z_are_found_by_their_names(tmp_path, name):
    (tmp_path / name).write_bytes(FILES[name])
    points = read_scan(tmp_path / name)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, POINTS)


@pytest.mark.parametrize(("name", "columns", "expected"), [
    ("a.bin", None, 4), ("a.pcd.bin", None, 5), ("a.BIN", 6, 6), ("a.pcd.bin", 3, 3),
])  # fmt: skip
def test_raw_floats_have_so_many_columns(tmp_path, name, columns, expected):
    values = sweep(expected)
    values.tofile(tmp_path / name)
    np.testing.assert_array_equal(read_scan(tmp_path / name, columns=columns), values)


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "f8", "f2"])
def test_an_array_may_be_of_any_floats(tmp_path, dtype):
    array = np.asfortranarray(POINTS.round().astype(dtype))
    np.save(tmp_path / "a.npy", array)
    points = read_scan(tmp_path / "a.npy")
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, array)


@pytest.mark.parametrize("columns", [3, 4, 6])
def test_an_array_of_one_coordinate_after_the_other_is_turned(tmp_path, columns):
    """As nuScenes' devkit holds points."""
    scan = sweep(columns)
    np.save(tmp_path / "a.npy", scan.T)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.npy"), scan)
    np.save(tmp_path / "b.npy", scan[:5])  # a few points
    np.testing.assert_array_equal(read_scan(tmp_path / "b.npy"), scan[:5])


@pytest.mark.parametrize(("viewpoint", "count"), [("0 0 0 1.0 0 0 -0", 0), ("0 0 1.5 1 0 0 0", 1)])
def test_a_viewpoint_elsewhere_is_said(tmp_path, viewpoint, count):
    (tmp_path / "a.pcd").write_bytes(pcd(b"", "binary", 0, VIEWPOINT=viewpoint))
    notes = []
    with collect_assumptions(notes):
        read_scan(tmp_path / "a.pcd")
    assert ["VIEWPOINT is not its origin" in note for note in notes] == [True] * count


def test_a_scan_may_be_empty(tmp_path):
    for name, content in (("a.pcd", pcd(b"", "binary", 0)), ("a.ply", ply(b"", "ascii", 0))):
        (tmp_path / name).write_bytes(content)
        assert read_scan(tmp_path / name).shape == (0, 3)


HEADERS = {
    "no x": "element vertex 1\nproperty float y\nproperty float z\n",
    "list": "element vertex 1\nproperty list uchar float x\n",
    "face first": "element face 1\nproperty float x\n",
}


def saved(array) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


BILLION = 10**9
HOSTILE = {
    "cut.bin": bytes(1602), "cut.pcd.bin": bytes(1604),
    "endless.ply": b"ply\n" * 10**5 + b"end_header\n", "cut.pcd": FILES["binary.pcd"][:-1],
    "cut-ascii.pcd": FILES["ascii.pcd"].rstrip().rpartition(b"\n")[0],
    "cut-line.pcd": FILES["ascii.pcd"].rpartition(b" ")[0],
    "cut-compressed.pcd": FILES["compressed.pcd"][:-1],
    "cut.ply": ply(records("<", *OF_PLY)[:-1], "binary_little_endian"),
    "huge-compressed.pcd": pcd(compressed(), "binary_compressed", BILLION),
    "digits.pcd": pcd(OF_PCD, "binary", POINTS="9" * 5000),
    "negative.pcd": pcd(OF_PCD, "binary", -1),
    "headless.ply": FILES["little.ply"].removeprefix(b"ply\n"),
    "longer.pcd": pcd(compressed(b"x"), "binary_compressed"), "more.pcd": pcd(OF_PCD, "binary", 49),
    "unfinished.pcd": pcd(OF_PCD, "binary", 0), "more-ascii.pcd": FILES["ascii.pcd"] + b"1 2 3 4\n",
    "other.pcd": pcd(OF_PCD, "zip"), "short.pcd": pcd(OF_PCD, "binary", SIZE="1 4"),
    "minus.pcd": pcd(OF_PCD, "binary", **NO_BYTE, COUNT="3 -1 1 1 1"),
    "lacks.pcd": pcd(OF_PCD, "binary", TYPE="", POINTS=""),
    "no-x.ply": ply(OF_PCD, "ascii", header=HEADERS["no x"]),
    "list.ply": ply(OF_PCD, "ascii", header=HEADERS["list"]),
    "face.ply": ply(OF_PCD, "ascii", header=HEADERS["face first"]),
    "flat.npy": saved(POINTS.ravel()), "radar.npy": saved(np.zeros((18, 125), np.float32)),
    "int.npy": saved(np.zeros((50, 3), np.int32)),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_damaged_scan_is_an_input_error_and_takes_no_memory(tmp_path, name):
    (tmp_path / name).write_bytes(HOSTILE[name])
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=name):
            read_scan(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 1e6 + 10 * len(HOSTILE[name])
    finally:
        tracemalloc.stop()


# --- the number of columns of raw files --------------------------------------------------------


def sweep(columns: int, *, lasers: int = 16, points: int = 3200) -> np.ndarray:
    """A scanner that turns: laser after laser of each direction, as they fire."""
    random = np.random.default_rng(0)
    turn = np.repeat(np.linspace(-3, 3, points // lasers), lasers)
    elevation = np.tile(np.radians([*range(-15, 1, 2), *range(1, 17, 2)]), points // lasers)
    elevation[::2], elevation[1::2] = elevation[1::2].copy(), elevation[::2].copy()
    distance = random.uniform(5, 60, points)
    scan = random.uniform(0, 255, (points, columns)).astype(np.float32)
    scan[:, 0] = distance * np.cos(elevation) * np.cos(turn)
    scan[:, 1] = distance * np.cos(elevation) * np.sin(turn)
    scan[:, 2] = distance * np.sin(elevation)
    return scan


@pytest.mark.parametrize(("right", "given"), [(3, 5), (5, None), (4, 5), (4, 6), (6, 5), (7, None)])
def test_another_number_of_columns_is_an_error_that_names_the_right_one(tmp_path, right, given):
    sweep(right, points=15 * 16 * 28).tofile(tmp_path / "a.bin")
    with pytest.raises(InputError, match=f"point_columns={right}"):
        read_scan(tmp_path / "a.bin", columns=given)


def padded(scan: np.ndarray) -> np.ndarray:
    """PCL's records of 32 bytes: x, y, z, 1, intensity, three gaps."""
    rows = np.zeros((len(scan), 8), np.float32)
    rows[:, :3], rows[:, 3], rows[:, 4] = scan[:, :3], 1, 0.3
    return rows


PACKED = np.zeros(3200, [("xyz", "<f4", 3), ("rest", "V17")])  # as Ouster writes it
PACKED["xyz"] = sweep(3)
AHEAD = sweep(4)[np.abs(sweep(4)[:, 1]) < sweep(4)[:, 0]]  # as from a LiDAR that looks ahead
SIX = sweep(6, points=6400)
OTHERS = {
    "29 bytes": PACKED, "float64": sweep(4).astype("<f8"), "int32": (1000 * sweep(4)).astype("<i4"),
    "padded": padded(AHEAD), "x, then y": np.ascontiguousarray(sweep(4).T),
    "6 columns, the first rings empty": np.where(np.arange(6400)[:, None] < 2400, 0, SIX),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_raw_files_of_other_records_are_refused(tmp_path, name):
    (tmp_path / "a.bin").write_bytes(OTHERS[name].tobytes())
    with pytest.raises(InputError, match=r"a\.bin"):
        read_scan(tmp_path / "a.bin")


SEEN = np.random.default_rng(2).random((3200, 1)) < 0.03
RAW = {
    "ahead": AHEAD,
    "a planar LiDAR": sweep(4) * np.float32([1, 1, 0, 1]),
    "an empty road": np.where(SEEN, sweep(4), 0),
    "a light but no return": np.where(SEEN, sweep(4), np.float32([0, 0, 0, 7])),
    "a covered lens": np.zeros((3200, 4), np.float32),
    "a beam straight ahead": sweep(4) * np.float32([1, 0, 0, 1]),
    "in no order": np.random.default_rng(1).permutation(sweep(4)),
}
RAW["in no order"][::7] = np.nan


@pytest.mark.parametrize("name", RAW)
def test_raw_files_that_look_like_others_are_read(tmp_path, name):
    (tmp_path / "a.bin").write_bytes(RAW[name].astype(np.float32).tobytes())
    np.testing.assert_array_equal(read_scan(tmp_path / "a.bin"), RAW[name])


DATA = os.environ.get("SSDNET_DATA")


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
@pytest.mark.parametrize(("folder", "columns"), [
    ("kitti_stream/velodyne_fov", 4),
    ("kitti_streets/velodyne_fov", 4),
    ("kitti_object/velodyne_fov", 4),
    ("kitti_drive_0009/velodyne_fov", 4),
    ("pandaset_front/points", 6),
])  # fmt: skip
def test_recorded_scans_have_one_number_of_columns(folder, columns):
    for path in sorted((Path(DATA) / folder).iterdir())[::5]:
        points = read_scan(path, columns=columns)
        assert points.shape[1] == columns
        for other in {4, 5, 6} - {columns}:
            with pytest.raises(InputError, match=f"point_columns={columns}"):
                read_scan(path, columns=other)
