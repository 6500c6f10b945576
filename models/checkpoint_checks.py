"""Checks of a checkpoint file before anything of its size is allocated."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from runtime.checks import shown

#: Ten times the largest network of the registry with its optimiser's state.
MAX_BYTES = 8 * 2**30
_ZIP_START = b"PK\x03\x04"


def check_archive(path: Path) -> None:
    """Raise ValueError unless the file is a zip archive as torch.save writes it.

    It must be whole by its checksums, and unpack to no more than its own size (torch.save does not
    compress). A damaged file may also raise any error of zipfile, an unreadable one OSError.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(len(_ZIP_START))
    if not _ZIP_START.startswith(start):
        raise ValueError("not an ssdnet checkpoint. Give a file that ssdnet-train wrote.")
    if not zipfile.is_zipfile(path):  # its directory comes last
        raise ValueError(f"truncated ({size} bytes). Copy it again.")
    if size > MAX_BYTES:
        raise ValueError(f"{size} bytes; a checkpoint has at most {MAX_BYTES}.")
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > size:
            raise ValueError(
                f"it would unpack from {size} to {unpacked} bytes; a checkpoint is "
                "stored uncompressed. Give a file that ssdnet-train wrote."
            )
        if (name := archive.testzip()) is not None:  # torch.load takes flipped bits
            raise ValueError(f"damaged (the checksum of {shown(name)} is wrong). Copy it again.")


def check_weights(weights: Mapping[str, object], expected: Mapping[str, Tensor]) -> None:
    """Raise ValueError unless the weights fit ``expected``, a network's state on any device.

    Names and shapes must be the same; floating-point values may have any precision, others must
    have the same type. Every tensor must hold its own values: an expanded one would grow when
    copied.
    """
    missing = sorted(expected.keys() - weights.keys())
    unknown = sorted(map(str, weights.keys() - expected.keys()))
    for problem, names in (("lacks the tensors", missing), ("has the unknown tensors", unknown)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise ValueError(f"it {problem} {', '.join(names[:3])}{more}")
    held: dict[int, int] = {}
    wanted = 0
    for name, value in expected.items():
        weight = weights[name]
        if not isinstance(weight, Tensor) or weight.layout != torch.strided:
            raise ValueError(f"{name} is not a dense tensor")
        if weight.shape != value.shape:
            raise ValueError(
                f"{name} has the shape {tuple(weight.shape)}, expected {tuple(value.shape)}"
            )
        if weight.dtype != value.dtype and not (
            weight.is_floating_point() and value.is_floating_point()
        ):
            raise ValueError(f"{name} is of type {weight.dtype}, expected {value.dtype}")
        storage = weight.untyped_storage()
        held[storage.data_ptr()] = storage.nbytes()
        wanted += weight.numel() * weight.element_size()
    if sum(held.values()) < wanted:
        raise ValueError("some of its tensors are larger than the data stored for them")
