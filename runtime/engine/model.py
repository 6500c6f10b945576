"""A model: the contract of its file, what its graph takes and gives, and its session."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
        path: of its file.
        contract: what the file states about itself.
        sha256: digest of the file, hexadecimal.
        heads: names of its heads, in the order of `HEADS`.
        size: (height, width) of its inputs; None = any.
        free_batch: whether one run takes any number of frames, or one only.
    """

    path: Path
    contract: Contract
    sha256: str
    heads: tuple[str, ...]
    size: tuple[int, int] | None
    free_batch: bool


def open_model(
    path: Path, *, sha256: str | None, provider: str, device_id: int, threads: int
) -> tuple[Model, Any]:
    """Open a model; outputs of its graph that are no heads are ignored.

    The first prediction shows whether the graph gives what the contract says, see `run_batch`.

    Args:
        path: of the file.
        sha256: digest that the file must have; None = any.
        provider: as of `open_session`.
        device_id: as of `open_session`.
        threads: as of `open_session`.

    Returns:
        The model, and the session of ONNX Runtime that runs it.

    Raises:
        ContractError: as `load_model_file` and `open_session`, and for a graph of other tensors.
        ProviderError: if the provider cannot be used.
    """
    file = load_model_file(path, sha256=sha256)
    session = open_session(file.content, provider=provider, device_id=device_id, threads=threads)
    shapes = {tensor.name: tensor.shape for tensor in session.get_inputs()}
    inputs = {tensor.name: (tensor.type, len(tensor.shape)) for tensor in session.get_inputs()}
    outputs = {tensor.name for tensor in session.get_outputs()}
    heads = tuple(name for name in HEADS if name in outputs)
    if inputs != _INPUTS or not heads:
        raise ContractError(
            f"not a model for this engine: expected the inputs {_INPUTS} (type, dimensions) and "
            f"some of the outputs {', '.join(HEADS)}, found {inputs} and {', '.join(outputs)}: "
            "export one with ssdnet-export"
        )
    batch, height, width = shapes["sparse_depth"]
    model = Model(
        path=path,
        contract=file.contract,
        sha256=file.sha256,
        heads=heads,
        size=(height, width) if isinstance(height, int) else None,
        free_batch=not isinstance(batch, int),
    )
    return model, session
