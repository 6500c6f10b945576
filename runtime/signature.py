"""Whether a graph has the inputs and outputs of the contract, and answers by it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from runtime.contract import check_size
from runtime.errors import ContractError, InferenceError

_INPUTS = {"rgb": ("tensor(uint8)", 4), "sparse_depth": ("tensor(float)", 3)}
_OUTPUTS = {
    "semantic": ("tensor(uint8)", 3),
    "depth": ("tensor(float)", 3),
    "boundary": ("tensor(float)", 3),
    "depth_uncertainty": ("tensor(float)", 3),
    "semantic_logits": ("tensor(float)", 4),
}


@dataclass(frozen=True)
class Signature:
    """What the tensors of a model say.

    size: (height, width) of its inputs, or None if it takes any
    heads: the names of the contract's outputs it has, in the contract's order
    free_batch: whether one run takes any number of frames, or one only
    """

    size: tuple[int, int] | None
    heads: tuple[str, ...]
    free_batch: bool = True


def read_signature(session: Any, *, num_classes: int) -> Signature:
    """Read the signature of an ONNX Runtime session.

    num_classes: how many classes the model's metadata names.
    Outputs that the contract does not know are left alone.
    Raises ContractError where a tensor of the contract is missing or of another type or shape.
    """
    try:
        return _read(session, num_classes)
    except UnicodeDecodeError as error:
        raise _foreign("names in UTF-8", f"others ({error})") from error


def _read(session: Any, num_classes: int) -> Signature:
    inputs = {tensor.name: tensor for tensor in session.get_inputs()}
    outputs = {tensor.name: tensor for tensor in session.get_outputs()}
    if inputs.keys() != _INPUTS.keys():
        raise _foreign(f"inputs {sorted(_INPUTS)}", f"{sorted(inputs)}")
    heads = tuple(name for name in _OUTPUTS if name in outputs)
    if not heads:
        raise _foreign(f"at least one output of {sorted(_OUTPUTS)}", f"{sorted(outputs)}")
    for name, (dtype, rank) in _INPUTS.items():
        _check_tensor(inputs[name], dtype, rank)
    for name in heads:
        _check_tensor(outputs[name], *_OUTPUTS[name])
    if "semantic" in heads and not num_classes:
        raise _foreign("the names of the classes of 'semantic' in the metadata", "none")
    if "depth_uncertainty" in heads and "depth" not in heads:
        raise _foreign("depth beside its depth_uncertainty", f"outputs {sorted(outputs)}")
    if "semantic_logits" in heads:
        channels = outputs["semantic_logits"].shape[1]
        if isinstance(channels, int) and channels != num_classes:
            raise _foreign(
                f"semantic_logits of the {num_classes} classes in the metadata", f"{channels}"
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
    if height is None or width is None:
        return Signature(size=None, heads=heads, free_batch=free_batch)
    try:
        return Signature(size=check_size((height, width)), heads=heads, free_batch=free_batch)
    except ValueError as error:
        raise _foreign("inputs of a size that pictures have", str(error)) from error


def check_outputs(
    outputs: Mapping[str, NDArray[Any]], *, frames: int, size: tuple[int, int], num_classes: int
) -> None:
    """Raise InferenceError unless each output, by its head, answers so many frames of `size`."""
    for head, values in outputs.items():
        planes = (num_classes,) if head == "semantic_logits" else ()
        if values.shape != (frames, *planes, *size):
            raise InferenceError(
                f"the model gave {head} of the shape {values.shape}, expected was "
                f"{(frames, *planes, *size)}: export it again with ssdnet-export"
            )


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
