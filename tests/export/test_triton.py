"""ssdnet-export --triton: config.pbtxt says what the ONNX file does."""

import pytest
from onnx import TensorProto, helper

from export.errors import ExportError
from export.triton import require_model_folder, triton_config, write_triton_model
from runtime import OutputError

# Read by protobuf with Triton's model_config.proto.
CONFIG = """\
name: "lite"
backend: "onnxruntime"
default_model_filename: "model.onnx"
max_batch_size: 8
input { name: "rgb" data_type: TYPE_UINT8 dims: [ 64, 96, 3 ] }
input { name: "sparse_depth" data_type: TYPE_FP32 dims: [ 64, 96 ] }
output { name: "semantic" data_type: TYPE_UINT8 dims: [ 64, 96 ] }
output { name: "depth" data_type: TYPE_FP32 dims: [ 64, 96 ] }
output { name: "boundary" data_type: TYPE_FP32 dims: [ 64, 96 ] }
output { name: "depth_uncertainty" data_type: TYPE_FP32 dims: [ 64, 96 ] }
"""


def test_the_config_says_what_the_file_does(exported, beside):
    folder = beside / "repository" / "lite"
    assert (folder / "1" / "model.onnx").read_bytes() == exported.path.read_bytes()
    found, expected = (folder / "config.pbtxt").read_text().splitlines(), CONFIG.splitlines()
    assert found[:6] == expected[:6]
    assert sorted(found) == sorted(expected)


def by_hand(batch):
    tensor = helper.make_tensor_value_info("depth", TensorProto.FLOAT, [batch, 64, "width"])
    return helper.make_model(helper.make_graph([], "g", [tensor], [tensor]))


@pytest.mark.parametrize(("batch", "most", "dims"), [("N", 8, "64, -1"), (1, 0, "1, 64, -1")])
def test_frames_are_batched_where_the_file_takes_several(batch, most, dims):
    config = triton_config(by_hand(batch), name="x")
    assert f"max_batch_size: {most}\n" in config
    assert config.count(f"dims: [ {dims} ]") == 2


@pytest.mark.parametrize("name", ["..", 'x"', "-x", "a b"])
def test_a_name_that_is_no_folder_is_refused(tmp_path, name):
    with pytest.raises(ExportError, match="cannot be a model of a Triton repository"):
        require_model_folder(tmp_path / name, overwrite=False)


def test_nothing_but_an_older_model_is_replaced(tmp_path):
    def write(*, overwrite):
        require_model_folder(folder, overwrite=overwrite)
        write_triton_model(folder, by_hand("N"), b"file", overwrite=overwrite)

    folder, other = tmp_path / "new" / "net", tmp_path / "new" / "other"
    require_model_folder(folder, overwrite=False)
    assert not folder.parent.exists()
    write(overwrite=False)
    other.mkdir()
    with pytest.raises(OutputError, match="exists"):
        write(overwrite=False)
    write(overwrite=True)
    assert other.is_dir()
    (folder / "labels.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"labels\.txt does not belong to the result"):
        write(overwrite=True)
    assert (folder / "1" / "model.onnx").read_bytes() == b"file"
