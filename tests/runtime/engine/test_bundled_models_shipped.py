"""What ships: the bundled models and stream keep their promises."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from runtime import Predictor, list_bundled_models
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames

pytest.importorskip("onnxruntime")


bundled = pytest.mark.parametrize("model", list_bundled_models())


def test_assets_stay_under_40_mb():
    assets = resources.files("runtime") / "assets"
    sizes = [path.stat().st_size for path in assets.rglob("*") if path.is_file()]
    assert 1e6 < sum(sizes) < 40e6


@bundled
def test_contract_of_a_bundled_model(model):
    with Predictor(model, warmup=0) as predictor:
        contract = predictor.contract
        assert {"semantic", "depth", "boundary"} <= set(predictor.heads)
        assert predictor.model.size is None
    assert model in (contract.model_name, f"{contract.model_name}-{contract.precision}")
    assert (contract.quantization is not None) == (contract.precision == "int8")
    assert [info.name for info in contract.classes][:4] == ["sky", "building", "pole", "road"]
    assert (len(contract.classes), contract.max_depth_m) == (11, 200)
    terms = contract.training["terms"]
    if model.startswith("ssdnet-open"):
        assert "PandaSet" in terms
        assert "by Scale AI and Hesai, https://pandaset.org, CC BY 4.0" in terms
        assert "EfficientNet-Lite0's weights: Apache-2.0" in terms
        kinds = {name.partition("/")[0] for name in contract.training["data"]}
        assert kinds == {"pandaset_street", "rendered", "ImageNet"}
    else:
        assert "(non-commercial)" in terms
    page = (Path(__file__).parents[3] / "docs" / "model_file.md").read_text().replace("\n", " ")
    assert f"schema version is {contract.schema_version}, also in the bundled files" in page
    assert contract.parity["semantic"]


def test_the_default_model_sees_the_street():
    """Road in front, sky or trees above, and depth close to the returns it was given."""
    frames = bundled_frames()
    assert len(frames) == 20
    frame = frames[0]
    with Predictor(threads=1) as predictor:
        prediction = predictor.predict(
            frame.rgb, frame.sparse_depth, focal_length_px=BUNDLED_FOCAL_LENGTH_PX
        )
        names = [info.name for info in predictor.contract.classes]
    assert prediction.valid
    assert prediction.degraded == ()
    bottom_middle = prediction.semantic[220:, 300:500]
    assert (bottom_middle == names.index("road")).mean() > 0.8
    measured = frame.sparse_depth > 0
    error = np.abs(prediction.depth - frame.sparse_depth)[measured]
    assert np.median(error / frame.sparse_depth[measured]) < 0.05
