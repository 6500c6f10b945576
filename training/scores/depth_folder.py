"""The folder of `ssdnet-eval --save`, with the depth of every answer."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError, OutputError
from runtime.drawing.encode import encode_metres
from runtime.files.atomic_write import atomic_path, require_writable
from runtime.files.own_folder import require_folder_free


@dataclass(frozen=True)
class DepthFolder:
    """Where depth is written: `folder/MODEL/SET/LIDAR/FRAME.png`, 16-bit, metres x 256.

    Attributes:
        folder: the folder, which is made with the first depth.
        overwrite: whether depth of the same names is replaced.
    """

    folder: Path
    overwrite: bool = False

    def require_free(self) -> None:
        """Raise an OutputError if the folder holds other files or cannot be written."""
        if not self.folder.is_dir():
            require_folder_free(self.folder, overwrite=self.overwrite)
        elif any(self.folder.iterdir()) and not self.overwrite:
            raise OutputError(
                f"{self.folder} is not empty: choose another --save, or replace depth of the same "
                "names with --overwrite"
            )
        else:
            require_writable(self.folder / "depth.png")

    def write(self, parts: Sequence[str], depth: NDArray[np.float32] | None) -> None:
        """Write a depth, float32 (H, W) [m], to the file of these folders and this name.

        Raises InputError if there is no depth, and OutputError if the file cannot be written.
        """
        if depth is None:
            raise InputError(
                f"{parts[0]} predicts no depth to write with --save: leave that model out"
            )
        names = [re.sub(r"[^\w.-]+", "_", part).lstrip(".") or "_" for part in parts]
        path = self.folder.joinpath(*names[:-1], f"{names[-1]}.png")
        with atomic_path(path, overwrite=self.overwrite) as made:
            made.write_bytes(encode_metres(depth))
