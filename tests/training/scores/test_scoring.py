"""What scoring feeds, and scores counted by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from models import NetworkOutput, SSDNetLiteConfig, create_model
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.heads import HEADS
from training.datasets.sample import AUXILIARY, Sample, make_frame
from training.lidar.split import LidarInput
from training.pages.pictures import draw_pictures
from training.scores.evaluated_set import EvaluatedSet
from training.scores.scored_model import ScoredModel
from training.scores.scoring import HeadMaps, Scores, split_frames, torch_predict
from training.scores.shared_classes import ScoredClasses

K = np.array([[300.0, 0, 60], [0, 300.0, 20], [0, 0, 1]])


def sample(**changes):
    """A wall at 10 m with sky above, road left and car right."""
    depth = np.full((60, 120), 10, np.float32)
    depth[:10] = 0
    semantic = np.full((60, 120), 3, np.uint8)
    semantic[:, 60:] = 8
    semantic[:10] = 0
    rgb = np.zeros((60, 120, 3), np.uint8)
    targets = {"depth": depth, "semantic": semantic}
    targets |= {name: changes.pop(name) for name in [*changes] if name in (*HEADS, *AUXILIARY)}
    keys = {key: changes.pop(key) for key in ("intrinsics", "returns") if key in changes}
    frame = make_frame(rgb, "wall", **{"intrinsics": K, **keys})
    return replace(Sample(frame, targets), **changes)


def recorded():
    rows = np.arange(60)[:, None] * np.ones(120, int)
    measured = (rows % 2 == 0) & (rows >= 10)
    depth = np.where(measured, 10 + rows / 10, 0).astype(np.float32)
    line = np.where(measured, rows // 2, -1).astype(np.int16)
    return replace(sample(returns=depth, scan_line=line), targets={"semantic": sample().semantic})


def split_lidar(sample, lidar="own", index=0):
    """The frame as validation splits it, at some place in its set."""
    return next(split_frames({index: sample}, [index], LidarInput.parse(lidar)))


def test_a_lidar_that_the_set_cannot_give_is_refused():
    with pytest.raises(InputError, match=r"wall cannot be validated.*validation\.lidar"):
        split_lidar(sample(intrinsics=None))
    with pytest.raises(InputError, match="64 lines of a recorded scan"):
        split_lidar(recorded(), "64")
    assert split_lidar(sample(intrinsics=None), "random:0.1").fed.any()


def figures(answer, frame=None):
    scores = Scores(11)
    scores.update(answer, split_lidar(frame or sample()))
    return scores.figures([*(f"c{i}" for i in range(10)), "Road"])


def test_each_figure_has_its_own_name():
    """Half of the wall is 2.5 m too far and the rest is right, so every figure differs."""
    mask = np.zeros((60, 120), np.uint8)
    mask[30:], mask[10:20] = 1, 255
    frame = sample(focal_baseline_px_m=400.0, road_mask=mask)
    ids = np.where(np.indices(mask.shape)[0] >= 45, 10, frame.semantic).astype(np.uint8)
    depth, scale, edge = frame.depth.copy(), np.full((60, 120), 3, np.float32), np.zeros((60, 120))
    depth[10:, :60], scale[:, 60:] = 12.5, 0.5
    edge[10], edge[10:, 60] = 1, 1
    result = figures(
        HeadMaps(
            semantic=ids, depth=depth, boundary=edge.astype(np.float32), depth_uncertainty=scale
        ),
        frame,
    )
    by_distance = {name: result.pop(name) for name in list(result) if "return" in name}
    assert list(by_distance) == [
        f"{error}_m_return_{px}_px" for px in ("0", "1_2", "3_6") for error in ("mae", "rmse")
    ]
    assert by_distance["mae_m_return_0_px"] == pytest.approx(1.25, rel=0.01)
    assert result.pop("iou_Road") == 0
    shown = {f"iou_c{number}": result.pop(f"iou_c{number}") for number in range(10)}
    assert {name: value for name, value in shown.items() if value == value} == {
        "iou_c0": 1.0,
        "iou_c3": 0.7,
        "iou_c8": 0.7,
    }
    in_metres = [f"m{among}" for among in ("", "_0_20", "_0_50", "_0_10")]
    assert {name: round(value, 3) for name, value in result.items()} == {
        "miou": 0.6,
        "accuracy": 0.75,
        "mean_accuracy": 0.8,
        "fwiou": 0.75,
        "road_iou": 0.5,
        **{f"mae_{name}": 1.25 for name in in_metres},
        **{f"rmse_{name}": 1.768 for name in in_metres},  # sqrt(2.5^2 / 2)
        "median_m": 0.0,  # the lower of two errors of half of the pixels each
        "imae_per_km": 10.0,  # 1000 / 10 - 1000 / 12.5 = 20, in half of the pixels
        "irmse_per_km": 14.142,
        "mae_m_confident_50": 0.0,
        "mae_m_confident_80": round(2.5 * 0.3 / 0.8, 3),
        "mae_m_confident_100": 1.25,
        "coverage_1": 1.0,
        "coverage_2": 1.0,
        "mae_px": 4.0,  # 400 / 10 - 400 / 12.5 = 8
        "rmse_px": 5.657,
        "boundary_f": 1.0,
        "boundary_precision": 1.0,
        "boundary_recall": 1.0,
        "boundary_threshold": 0.3,
    }
    without = figures(HeadMaps(depth=depth), sample(semantic=np.full_like(mask, 255)))
    assert without.keys() == by_distance.keys() | {
        name for name in result if "_m" in name or "_km" in name if "confident" not in name
    }


def test_a_network_of_canonical_depth_sees_it_and_answers_in_metres():
    """A fake network that answers what it is fed: the factor must come off again."""

    class Copy(torch.nn.Module):
        config, heads = SSDNetLiteConfig(canonical_focal_px=450.0), ("depth", "depth_uncertainty")
        rgb_mean = torch.zeros(1)

        def forward(self, rgb, sparse_depth):
            self.fed = sparse_depth
            metres = sparse_depth / 200
            return NetworkOutput(depths=(metres,), depth_uncertainty=metres / 10)

    network, truth = Copy(), sample()
    for focal, factor in ((300.0, 1.5), (900.0, 0.5), (None, 1.0)):
        answer = torch_predict(network)(truth.rgb, truth.depth, focal)
        np.testing.assert_allclose(network.fed[0, 0], truth.depth * np.float32(factor))
        np.testing.assert_allclose(answer.depth, truth.depth, rtol=1e-6)
        np.testing.assert_allclose(answer.depth_uncertainty, truth.depth / 10, rtol=1e-6)
    network.config = replace(network.config, canonical_focal_px=None)
    torch_predict(network)(truth.rgb, truth.depth, 300.0)
    np.testing.assert_array_equal(network.fed[0, 0], truth.depth)


def test_a_network_whose_training_diverged_is_not_scored():
    truth = sample()
    for name, head in (("sparse-conv", "depth"), ("enet", "semantic")):
        network = create_model(name)
        torch.nn.init.constant_(next(network.parameters()), float("nan"))
        with pytest.raises(SSDNetError, match=f"the network's {head} is not finite"):
            torch_predict(network)(truth.rgb, truth.depth, 300.0)


def test_frames_are_scored_with_their_own_focal_length():
    seen = []

    def predict(rgb, fed, focal_length_px):
        seen.append(focal_length_px)
        return HeadMaps(depth=sample().depth)

    frames = [split_lidar(sample(), "random:0.1"), split_lidar(sample(intrinsics=None), "none")]
    data = EvaluatedSet("set", (), ScoredClasses("camvid", ()), ())
    for frame in frames:
        data.answer(ScoredModel(predict, "none"), frame.sample, frame.fed, 0)
    assert seen == [300.0, None]
    source = [sample(), sample(intrinsics=None)]
    network = create_model("ssdnet-lite")
    list(draw_pictures(predict, source, network, lidar=LidarInput("none"), count=2))
    assert seen == [300.0, None] * 2
