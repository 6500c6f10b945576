"""A model: the contract of its file, the inputs and outputs of its graph, and its session."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.base.arrays import Size
from runtime.base.errors import ContractError
from runtime.contract.contract import Contract
from runtime.contract.heads import HEADS
from runtime.contract.model_file import load_model_file
from runtime.engine.session import open_session

_INPUTS = {"rgb": ("tensor(uint8)", 4), "sparse_depth": ("tensor(float)", 3)}


@dataclass(frozen=True)
class Model:
    """A model whose file was opened.

    Attributes:
        path: path of its file.
        contract: what the file states about itself.
        sha256: SHA-256 of the file, hexadecimal.
        heads: names of its heads, in the order of `HEADS`.
        size: (height, width) of its inputs; None: any size.
        free_batch: True if one run takes any number of frames, False if it takes only one.
    """

    path: Path
    contract: Contract
    sha256: str
    heads: tuple[str, ...]
    size: Size | None
    free_batch: bool


def open_model(
    path: Path, *, sha256: str | None, provider: str, device_id: int, threads: int
) -> tuple[Model, Any]:
    """Open a model. Outputs of its graph that are not in `HEADS` are ignored.

    `HEADS` also finds the heads of installed packages.

    The first prediction checks whether the outputs agree with the contract, see `run_batch`.

    Args:
        path: the model file.
        sha256: SHA-256 that the file must have; None: any.
        provider: see `open_session`.
        device_id: see `open_session`.
        threads: see `open_session`.

    Returns:
        The model, and the session of ONNX Runtime that runs it.

    Raises:
        ContractError: as for `load_model_file` and `open_session`, if the graph has other inputs
            or outputs, and if a package that registers one of its heads cannot be imported.
        ProviderError: if the provider cannot be used.
    """
    file = load_model_file(path, sha256=sha256)
    session = open_session(file.content, provider=provider, device_id=device_id, threads=threads)
    shapes = {tensor.name: tensor.shape for tensor in session.get_inputs()}
    inputs = {tensor.name: (tensor.type, len(tensor.shape)) for tensor in session.get_inputs()}
    outputs = [tensor.name for tensor in session.get_outputs()]
    try:
        known = [name for name in outputs if name in HEADS]  # first, so that HEADS lists them
    except ValueError as error:
        raise ContractError(f"{path}: {error}: install what that package needs") from error
    heads = tuple(name for name in HEADS if name in known)
    if inputs != _INPUTS or not heads:
        raise ContractError(
            f"{path}: not a model for this engine: expected the inputs {_INPUTS} (type, dimensions)"
            f" and some of the outputs {', '.join(HEADS)}, found {inputs} and {', '.join(outputs)}"
            ": export one with ssdnet-export, or install the package that registers its heads"
        )
    batch, height, width = shapes["sparse_depth"]
    size = (height, width) if isinstance(height, int) else None
    free_batch = not isinstance(batch, int)
    return Model(path, file.contract, file.sha256, heads, size, free_batch), session
