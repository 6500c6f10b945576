"""What a checkpoint file may hold, checked before anything of its size is allocated."""

import pickletools
import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

#: The largest network of the registry with an optimiser's state takes a tenth of it.
MAX_BYTES = 8 * 2**30
_ZIP_START = b"PK\x03\x04"
_PICKLE = "data.pkl"
#: What tensors and plain values are pickled with; more could call, and allocate, anything.
_KNOWN_GLOBALS = frozenset(
    {"collections OrderedDict", "torch._utils _rebuild_tensor_v2"}
    | {
        f"torch {kind}Storage"
        for kind in ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte")
    }
    | {f"torch {kind}Storage" for kind in ("Bool", "ComplexFloat", "ComplexDouble")}
)


def check_archive(path: Path) -> None:
    """Raise ValueError unless the file is a zip archive as torch.save writes it.

    It must be whole, unpack to no more than its own size (torch.save does not compress), and name
    nothing beside tensors and plain values. Raises OSError for a file that cannot be read, and
    whatever zipfile and pickletools raise for a damaged one.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(len(_ZIP_START))
    if not _ZIP_START.startswith(start):
        raise ValueError(
            "not a checkpoint but a file of another kind. Give a file that ssdnet-train wrote."
        )
    if not zipfile.is_zipfile(path):  # its directory comes last
        raise ValueError(f"truncated ({size} bytes). Copy it again.")
    if size > MAX_BYTES:
        raise ValueError(f"{size} bytes; a checkpoint has at most {MAX_BYTES}.")
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > size:
            raise ValueError(
                f"it would unpack from {size} to {unpacked} bytes, which no checkpoint does. "
                "Give a file that ssdnet-train wrote."
            )
        for entry in entries:
            if entry.filename.endswith(_PICKLE):
                _check_pickle(archive.read(entry))


def check_weights(weights: Mapping[str, object], expected: Mapping[str, Tensor]) -> None:
    """Raise ValueError unless the weights are those of a network, of whatever precision.

    ``expected``: the network's own state, which may lie on the device "meta". Names and shapes must
    be the same; floating-point numbers may be of any precision, others of the same type; every
    tensor must hold its own values, since one that repeats a few would grow when it is copied.
    """
    missing = sorted(expected.keys() - weights.keys())
    unknown = sorted(map(str, weights.keys() - expected.keys()))
    for said, names in (("lacks", missing), ("has besides", unknown)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise ValueError(f"it {said} {', '.join(names[:3])}{more}")
    held: dict[int, int] = {}
    wanted = 0
    for name, value in expected.items():
        weight = weights[name]
        if not isinstance(weight, Tensor) or weight.layout != torch.strided:
            raise ValueError(f"{name} is no plain tensor")
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
        raise ValueError("some of its tensors repeat values that they do not hold")


def _check_pickle(content: bytes) -> None:
    for opcode, argument, _ in pickletools.genops(content):
        foreign = opcode.name == "GLOBAL" and argument not in _KNOWN_GLOBALS
        if foreign or opcode.name in ("STACK_GLOBAL", "INST"):
            # Nothing is said of how to run it all the same.
            raise ValueError(
                "it holds something else than tensors and plain values, which could run code when "
                "read. Give a file that ssdnet-train wrote."
            )
