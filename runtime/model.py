"""An open model: the contract of its file, and a session whose graph fits the contract."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.contract import Contract
from runtime.errors import ContractError
from runtime.heads import HEADS, Unit
from runtime.model_file import load_model_file
from runtime.session import open_session

_INPUTS = {"rgb": ("tensor(uint8)", 4), "sparse_depth": ("tensor(float)", 3)}
_ONNX_TYPES = {"uint8": "tensor(uint8)", "float32": "tensor(float)"}


@dataclass(frozen=True)
class Model:
    """A model that is ready to run.

    Attributes:
        contract: of its file.
        sha256: of its file, hexadecimal.
        session: of ONNX Runtime.
        heads: names of its heads, in the order of `HEADS`.
        size: (height, width) of its inputs; None = any.
        free_batch: whether one run takes any number of frames, or one only.
    """

    contract: Contract
    sha256: str
    session: Any
    heads: tuple[str, ...]
    size: tuple[int, int] | None
    free_batch: bool


def open_model(
    path: Path, *, sha256: str | None, provider: str, device_id: int, threads: int
) -> Model:
    """Open a model; outputs of its graph that are no heads are ignored.

    Args:
        path: of the file.
        sha256: digest that the file must have; None = any.
        provider: as of `open_session`.
        device_id: as of `open_session`.
        threads: as of `open_session`.

    Raises:
        ContractError: as `load_model_file` and `open_session`, and where a tensor of the graph is
            missing or of another type or shape.
        ProviderError: if the provider cannot be used.
    """
    file = load_model_file(path, sha256=sha256)
    session = open_session(file.content, provider=provider, device_id=device_id, threads=threads)
    inputs = {tensor.name: tensor for tensor in session.get_inputs()}
    outputs = {tensor.name: tensor for tensor in session.get_outputs()}
    if inputs.keys() != _INPUTS.keys():
        raise _foreign(f"inputs {sorted(_INPUTS)}", f"{sorted(inputs)}")
    for name, (dtype, rank) in _INPUTS.items():
        _check_tensor(inputs[name], dtype, rank)
    heads = _check_heads(outputs, num_classes=len(file.contract.classes))
    shapes = [_fixed_sides(inputs[name].shape) for name in _INPUTS]
    if shapes[0] != (*shapes[1], 3) or (shapes[1][1] is None) != (shapes[1][2] is None):
        raise _foreign(
            "rgb (N, H, W, 3) and sparse_depth (N, H, W) of one size, both sides fixed or free",
            f"{inputs['rgb'].shape} and {inputs['sparse_depth'].shape}",
        )
    batch, height, width = shapes[1]
    return Model(
        contract=file.contract,
        sha256=file.sha256,
        session=session,
        heads=heads,
        size=None if height is None or width is None else (height, width),
        free_batch=batch is None,
    )


def _check_heads(outputs: dict[str, Any], *, num_classes: int) -> tuple[str, ...]:
    """Return the names of the heads among the outputs. Raises ContractError."""
    heads = [head for head in HEADS.values() if head.name in outputs]
    if not heads:
        raise _foreign(f"at least one output of {sorted(HEADS)}", f"{sorted(outputs)}")
    for head in heads:
        _check_tensor(outputs[head.name], _ONNX_TYPES[head.dtype], 4 if head.per_class else 3)
        if head.unit is Unit.CLASS_ID and not num_classes:
            raise _foreign(f"the names of the classes of {head.name!r} in the metadata", "none")
        if head.needs and head.needs not in outputs:
            raise _foreign(f"{head.needs} beside its {head.name}", f"outputs {sorted(outputs)}")
        channels = outputs[head.name].shape[1]
        if head.per_class and isinstance(channels, int) and channels != num_classes:
            raise _foreign(
                f"{head.name} of the {num_classes} classes in the metadata", f"{channels}"
            )
    return tuple(head.name for head in heads)


def _check_tensor(tensor: Any, dtype: str, rank: int) -> None:
    if tensor.type != dtype or len(tensor.shape) != rank:
        raise _foreign(
            f"{tensor.name} to be {dtype} with {rank} dimensions", f"{tensor.type} {tensor.shape}"
        )
    if _fixed_sides(tensor.shape)[0] not in (1, None):
        raise _foreign(f"{tensor.name} to take one frame at a time", f"{tensor.shape}")


def _fixed_sides(shape: list[Any]) -> tuple[int | None, ...]:
    """A shape with None for the names of free sides."""
    return tuple(side if isinstance(side, int) else None for side in shape)


def _foreign(expected: str, found: str) -> ContractError:
    return ContractError(
        f"not a model for this engine: expected {expected}, found {found}: "
        "export one with ssdnet-export"
    )
