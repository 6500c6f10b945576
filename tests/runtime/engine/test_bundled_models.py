"""A model by its name, its path, or not at all."""

import os
import shutil
from pathlib import Path

import pytest

import runtime.engine.bundled_models
from runtime import InputError, Predictor
from runtime.engine.bundled_models import DEFAULT_MODEL, find_model, list_bundled_models

pytest.importorskip("onnxruntime")


@pytest.fixture
def assets(tmp_path, model_file, monkeypatch):
    """An installation with the models `ssdnet-lite` and `other`."""
    folder = tmp_path / "installed" / "assets"
    folder.mkdir(parents=True)
    monkeypatch.setattr(
        runtime.engine.bundled_models.resources, "files", lambda package: folder.parent
    )
    for name in ("ssdnet-lite", "other"):
        shutil.copy(model_file(), folder / f"{name}.onnx")
    (folder / "MODEL_CARD.md").touch()
    return folder


def test_what_is_installed():
    assert DEFAULT_MODEL in list_bundled_models()
    assert find_model(DEFAULT_MODEL) == find_model(None)
    assert find_model(None).is_file()


def test_a_file_in_the_folder_is_a_model(assets):
    assert list_bundled_models() == ["other", "ssdnet-lite"]
    assert find_model("other") == assets / "other.onnx"
    with Predictor("other", warmup=0) as predictor:
        assert predictor.model.path == assets / "other.onnx"


@pytest.mark.parametrize(
    "text", ["a.onnx", "A.ONNX", "./other", "down/other", "/other", f"..{os.sep}x.bin", "x/"]
)
def test_an_ending_or_a_folder_makes_a_path(assets, text):
    assert find_model(text) == Path(text)


def test_a_file_of_a_models_name_in_the_current_folder_is_not_taken(
    assets, tmp_path, monkeypatch, model_file
):
    monkeypatch.chdir(tmp_path)
    for name in ("other", "mine"):
        shutil.copy(model_file(), name)
    assert find_model("other") == assets / "other.onnx"
    with Predictor("./other", warmup=0) as predictor:
        assert predictor.model.path == Path("other")
    with pytest.raises(InputError, match="mine"):
        find_model("mine")


@pytest.mark.parametrize("name", ["ssdnet-huge", "", "other.bin", "x" * 5000])
def test_an_unknown_name_lists_those_that_are_there(assets, name):
    with pytest.raises(InputError, match="other, ssdnet-lite") as error:
        Predictor(name)
    assert len(str(error.value)) < 600


def test_what_is_no_text_is_refused():
    with pytest.raises(InputError, match="path or a name"):
        find_model(["ssdnet-lite"])
