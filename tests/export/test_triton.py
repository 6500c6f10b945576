"""ssdnet-export --triton: config.pbtxt, parsed back, says what the ONNX file does."""

import onnx
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, text_format
from onnx import TensorProto, helper

from export.errors import ExportError
from export.triton import require_replaceable, triton_config, write_triton_model
from runtime import OutputError

#: Of Triton's model_config.proto: fields as (name, number, type, repeated).
STRING, INT32, INT64, ENUM, MESSAGE = 9, 5, 3, 14, 11
TENSOR = [("name", 1, STRING, False), ("data_type", 2, ENUM, False)]
MESSAGES = {
    "ModelInput": [*TENSOR, ("dims", 4, INT64, True)],
    "ModelOutput": [*TENSOR, ("dims", 3, INT64, True)],
    "ModelConfig": [
        ("name", 1, STRING, False),
        ("max_batch_size", 4, INT32, False),
        ("input", 5, MESSAGE, True),
        ("output", 6, MESSAGE, True),
        ("default_model_filename", 8, STRING, False),
        ("backend", 17, STRING, False),
    ],
}
TYPES = {"TYPE_INVALID": 0, "TYPE_UINT8": 2, "TYPE_FP32": 11}
TYPE_OF = {2: TensorProto.UINT8, 11: TensorProto.FLOAT}


def parse(text):
    """Read a config with protobuf, by the part of Triton's schema that it may use."""
    file = descriptor_pb2.FileDescriptorProto(name="part.proto", package="inference")
    types = file.enum_type.add(name="DataType")
    for name, number in TYPES.items():
        types.value.add(name=name, number=number)
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, number, kind, repeated in fields:
            added = message.field.add(
                name=field, number=number, type=kind, label=3 if repeated else 1
            )
            if kind == ENUM:
                added.type_name = ".inference.DataType"
            if kind == MESSAGE:
                added.type_name = f".inference.Model{field.capitalize()}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    config = pool.FindMessageTypeByName("inference.ModelConfig")
    return text_format.Parse(text, message_factory.GetMessageClass(config)())


def sides(tensor):
    return [
        dim.dim_value if dim.HasField("dim_value") else -1
        for dim in tensor.type.tensor_type.shape.dim
    ]


def check(config, graph):
    """The batch, which Triton puts before `dims`, and all else of each tensor."""
    for entries, tensors in ((config.input, graph.input), (config.output, graph.output)):
        assert [entry.name for entry in entries] == [tensor.name for tensor in tensors]
        for entry, tensor in zip(entries, tensors, strict=True):
            assert TYPE_OF[entry.data_type] == tensor.type.tensor_type.elem_type
            batch = [-1] if config.max_batch_size else []
            assert [*batch, *entry.dims] == sides(tensor)


def test_the_config_says_what_the_file_does(exported, beside):
    folder = beside / "repository" / exported.path.stem
    served = folder / "1" / "model.onnx"
    assert served.read_bytes() == exported.path.read_bytes()
    config = parse((folder / "config.pbtxt").read_text())
    assert config.name == folder.name
    assert config.backend == "onnxruntime"
    assert config.default_model_filename == served.name
    assert config.max_batch_size == 8
    assert list(config.input[0].dims) == [64, 96, 3]
    check(config, onnx.load(served).graph)


def by_hand(batch, kind=TensorProto.FLOAT):
    tensor = helper.make_tensor_value_info("depth", kind, [batch, 64, "width"])
    return helper.make_model(helper.make_graph([], "g", [tensor], [tensor]))


@pytest.mark.parametrize(("batch", "most"), [("N", 8), (1, 0)])
def test_frames_are_batched_where_the_file_takes_several(batch, most):
    model = by_hand(batch)
    config = parse(triton_config(model, name="fixed"))
    assert config.max_batch_size == most
    assert list(config.input[0].dims) == ([64, -1] if batch == "N" else [1, 64, -1])
    check(config, model.graph)


@pytest.mark.parametrize("name", ["..", 'x"', "-x", "a b"])
def test_a_name_that_is_no_folder_is_refused(tmp_path, name):
    with pytest.raises(ExportError, match="cannot be a model of a Triton repository"):
        require_replaceable(tmp_path / name, overwrite=False)


def test_a_type_that_the_contract_has_not_is_refused():
    with pytest.raises(ExportError, match="depth is DOUBLE"):
        triton_config(by_hand("N", TensorProto.DOUBLE), name="x")


def test_a_repository_that_cannot_be_made_is_refused_beforehand(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="Not a directory"):
        require_replaceable(tmp_path / "file" / "net", overwrite=False)


def test_nothing_but_an_older_model_is_replaced(tmp_path):
    def write(**options):
        return write_triton_model(tmp_path, by_hand("N"), b"file", name="net", **options)

    folder = write()
    other = tmp_path / "other"
    other.mkdir()
    with pytest.raises(OutputError, match="exists"):
        write()
    write(overwrite=True)
    assert other.is_dir()
    (folder / "labels.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"labels\.txt does not belong to the result"):
        write(overwrite=True)
    (folder / "labels.txt").unlink()
    (folder / "config.pbtxt").unlink()
    with pytest.raises(OutputError, match="not a model of a Triton repository"):
        write(overwrite=True)
    assert (folder / "1" / "model.onnx").read_bytes() == b"file"
