"""Checks that a graph has the inputs and outputs of the contract."""

from dataclasses import dataclass
from typing import Any

from runtime.contract import check_size
from runtime.errors import ContractError
from runtime.heads import HEADS, Unit

_INPUTS = {"rgb": ("tensor(uint8)", 4), "sparse_depth": ("tensor(float)", 3)}
_ONNX_TYPES = {"uint8": "tensor(uint8)", "float32": "tensor(float)"}


@dataclass(frozen=True)
class Signature:
    """Inputs and outputs of a model.

    Attributes:
        size: (height, width) of its inputs; None = any.
        heads: names of its heads, in the order of `HEADS`.
        free_batch: whether one run takes any number of frames, or one only.
    """

    size: tuple[int, int] | None
    heads: tuple[str, ...]
    free_batch: bool = True


def read_signature(session: Any, *, num_classes: int) -> Signature:
    """Read the signature of an ONNX Runtime session; outputs that are no heads are ignored.

    Args:
        session: the open session.
        num_classes: number of classes in the model's metadata.

    Raises:
        ContractError: where a tensor is missing or of another type or shape.
    """
    try:
        return _read(session, num_classes)
    except UnicodeDecodeError as error:
        raise _foreign("names in UTF-8", f"other bytes ({error})") from error


def _read(session: Any, num_classes: int) -> Signature:
    inputs = {tensor.name: tensor for tensor in session.get_inputs()}
    outputs = {tensor.name: tensor for tensor in session.get_outputs()}
    if inputs.keys() != _INPUTS.keys():
        raise _foreign(f"inputs {sorted(_INPUTS)}", f"{sorted(inputs)}")
    heads = [head for head in HEADS.values() if head.name in outputs]
    names = tuple(head.name for head in heads)
    if not heads:
        raise _foreign(f"at least one output of {sorted(HEADS)}", f"{sorted(outputs)}")
    for name, (dtype, rank) in _INPUTS.items():
        _check_tensor(inputs[name], dtype, rank)
    for head in heads:
        _check_tensor(outputs[head.name], _ONNX_TYPES[head.dtype], 4 if head.per_class else 3)
        if head.unit is Unit.CLASS_ID and not num_classes:
            raise _foreign(f"the names of the classes of {head.name!r} in the metadata", "none")
        if head.needs and head.needs not in names:
            raise _foreign(f"{head.needs} beside its {head.name}", f"outputs {sorted(outputs)}")
        channels = outputs[head.name].shape[1]
        if head.per_class and isinstance(channels, int) and channels != num_classes:
            raise _foreign(
                f"{head.name} of the {num_classes} classes in the metadata", f"{channels}"
            )
    if inputs["rgb"].shape[3] != 3:
        raise _foreign("rgb of shape (N, H, W, 3)", f"{inputs['rgb'].shape}")
    sizes = {
        tuple(side if isinstance(side, int) else None for side in tensor.shape[1:3])
        for tensor in inputs.values()
    }
    if len(sizes) > 1:
        raise _foreign("rgb and sparse_depth of one size", f"{sorted(map(str, sizes))}")
    height, width = sizes.pop()
    if (height is None) != (width is None):
        raise _foreign("height and width both fixed or both free", f"{inputs['rgb'].shape}")
    free_batch = not any(isinstance(tensor.shape[0], int) for tensor in inputs.values())
    try:
        size = None if height is None else check_size((height, width))
    except ValueError as error:
        raise _foreign("inputs of the size of images", str(error)) from error
    return Signature(size, names, free_batch)


def _check_tensor(tensor: Any, dtype: str, rank: int) -> None:
    if tensor.type != dtype or len(tensor.shape) != rank:
        raise _foreign(
            f"{tensor.name} to be {dtype} with {rank} dimensions", f"{tensor.type} {tensor.shape}"
        )
    batch = tensor.shape[0]
    if isinstance(batch, int) and batch != 1:
        raise _foreign(f"{tensor.name} to take one frame at a time", f"a batch of {batch}")


def _foreign(expected: str, found: str) -> ContractError:
    return ContractError(
        f"not a model for this engine: expected {expected}, found {found}: "
        "export one with ssdnet-export"
    )
