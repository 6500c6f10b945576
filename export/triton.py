"""A model repository of NVIDIA's Triton Inference Server with an exported file.

DIR/NAME/config.pbtxt names the tensors (`ModelConfig` of Triton's model_config.proto, in protobuf's
text form), and DIR/NAME/1/model.onnx is the file itself. The server is started with `tritonserver
--model-repository=DIR`.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import onnx

from export.errors import ExportError
from runtime.files.own_folder import atomic_folder, require_folder_free

# Number of frames that the server may put into one run of a model whose batch axis is free.
MAX_BATCH_SIZE = 8
MODEL_FILE = "model.onnx"

# Types of the contract's tensors, see `runtime.contract.heads.Head.dtype`.
_TYPES = {onnx.TensorProto.UINT8: "TYPE_UINT8", onnx.TensorProto.FLOAT: "TYPE_FP32"}
_FREE = -1
_FOLDER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def triton_config(model: onnx.ModelProto, *, name: str) -> str:
    """Return config.pbtxt for a model: its tensors, and whether frames may be batched.

    A batch axis that is free everywhere is left out of `dims`, since Triton adds it.

    Args:
        model: the ONNX model.
        name: name of the model in the repository.
    """
    tensors = [*model.graph.input, *model.graph.output]
    batched = all(_dims(tensor)[0] == _FREE for tensor in tensors)
    return "\n".join(
        [
            f'name: "{name}"',
            'backend: "onnxruntime"',
            f'default_model_filename: "{MODEL_FILE}"',
            f"max_batch_size: {MAX_BATCH_SIZE if batched else 0}",
            *_entries("input", model.graph.input, batched=batched),
            *_entries("output", model.graph.output, batched=batched),
            "",
        ]
    )


def write_triton_model(
    folder: Path, model: onnx.ModelProto, content: bytes, *, overwrite: bool
) -> None:
    """Write a model into a repository; other models there are not touched.

    Args:
        folder: folder of the model in the repository, named like the model.
        model: the ONNX model.
        content: bytes of the model file.
        overwrite: replace an older model of that name.

    Raises:
        OutputError: if the folder cannot be written or replaced.
    """
    with atomic_folder(folder, overwrite=overwrite) as temporary:
        (temporary / "1").mkdir()
        (temporary / "1" / MODEL_FILE).write_bytes(content)
        (temporary / "config.pbtxt").write_text(triton_config(model, name=folder.name))


def require_model_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that `write_triton_model` can write a folder.

    Raises:
        ExportError: if the name cannot be that of a model in a repository.
        OutputError: if the folder cannot be made or replaced.
    """
    if not _FOLDER_NAME.fullmatch(folder.name):
        raise ExportError(
            f"{folder.name!r} cannot be a model of a Triton repository, whose name may hold "
            "letters, digits, dots, dashes and underscores: give the file such a name"
        )
    # The check creates missing parents, but a new repository must not remain if the export fails.
    new = folder if folder.parent.exists() else folder.parent
    require_folder_free(new, overwrite=overwrite)


def _entries(kind: str, tensors: Iterable[onnx.ValueInfoProto], *, batched: bool) -> Iterable[str]:
    for tensor in tensors:
        data_type = _TYPES[tensor.type.tensor_type.elem_type]
        dims = ", ".join(map(str, _dims(tensor)[batched:]))
        yield f'{kind} {{ name: "{tensor.name}" data_type: {data_type} dims: [ {dims} ] }}'


def _dims(tensor: onnx.ValueInfoProto) -> list[int]:
    """Return the sides of a tensor; -1 stands for a free side."""
    dims = tensor.type.tensor_type.shape.dim
    return [dim.dim_value if dim.HasField("dim_value") else _FREE for dim in dims]
