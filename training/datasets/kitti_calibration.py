"""KITTI's calibration and scans as the engine reads them; what is wrong is a DatasetError."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import DatasetError, InputError
from runtime.io.calibration import Calibration
from runtime.io.kitti_calibration import NumbersFile, chain
from runtime.io.kitti_scan import read_scan


@contextmanager
def dataset_errors() -> Iterator[None]:
    """Raise what the engine's readers find wrong in a file as `DatasetError`."""
    try:
        yield
    except InputError as error:
        raise DatasetError(str(error)) from error


def read_calibration(path: Path | str) -> Calibration:
    """Read camera 2's projection of LiDAR returns from one text file of `name: numbers` lines.

    Needs S_rect_02, P_rect_02, R_rect_00, velo_to_cam_R and velo_to_cam_T (KITTI's own names, the
    last two with a prefix).
    Raises `DatasetError` for a missing file, a missing name or a wrong count of numbers.
    """
    with dataset_errors():
        numbers = NumbersFile(Path(path))
        projection = numbers.matrix("P_rect_02", 3, 4)
        rectify = numbers.matrix("R_rect_00", 3, 3)
        turn, shift = numbers.matrix("velo_to_cam_R", 3, 3), numbers.matrix("velo_to_cam_T", 3, 1)
        width, height = numbers.matrix("S_rect_02", 1, 2)[0]
        matrices = chain(projection, rectify, np.hstack([turn, shift]))
        return Calibration(*matrices, (int(height), int(width)))


def read_raw_calibration(folder: Path | str, camera: int) -> Calibration:
    """Read a colour camera's projection from the files of a day of KITTI raw data.

    `folder` holds calib_cam_to_cam.txt and calib_velo_to_cam.txt; `camera` is 2 or 3. Raises
    `DatasetError` as `read_calibration`.
    """
    with dataset_errors():
        return Calibration.from_kitti(Path(folder), camera=camera)


class CalibrationFile:
    """A text file of `name: numbers` lines. Raises `DatasetError` if it cannot be read."""

    def __init__(self, path: Path) -> None:
        with dataset_errors():
            self._numbers = NumbersFile(path)

    def matrix(self, name: str, rows: int, columns: int) -> npt.NDArray[np.float64]:
        """The numbers under a name. Raises `DatasetError` if they are missing or not as many."""
        with dataset_errors():
            return self._numbers.matrix(name, rows, columns)


def read_points(path: Path | str) -> npt.NDArray[np.float32]:
    """Read one scan: float32 (N, 4) of x, y, z [m] in the LiDAR frame and reflectance 0..1.

    Raises `DatasetError` if the file is missing or is not whole records of four float32.
    """
    with dataset_errors():
        return read_scan(Path(path))
