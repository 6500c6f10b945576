"""What scoring feeds, and scores counted by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from models import NetworkOutput, SSDNetLiteConfig, create_model
from runtime.errors import InputError, SSDNetError
from runtime.heads import HEADS
from training.datasets.sample import AUXILIARY, Sample
from training.evaluation.pictures import draw_pictures
from training.evaluation.scoring import HeadMaps, score, split_frames, torch_predict
from training.lidar.split import LidarInput

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
    return replace(Sample(rgb, targets, K, "wall"), **changes)


def recorded():
    rows = np.arange(60)[:, None] * np.ones(120, int)
    measured = (rows % 2 == 0) & (rows >= 10)
    depth = np.where(measured, 10 + rows / 10, 0).astype(np.float32)
    line = np.where(measured, rows // 2, -1).astype(np.int16)
    return sample(depth=depth, scan_line=line)


def split_lidar(sample, lidar="own", index=0):
    """The frame as validation splits it, at some place in its set."""
    return next(split_frames({index: sample}, [index], LidarInput.parse(lidar)))


def test_a_lidar_that_the_set_cannot_give_is_refused():
    with pytest.raises(InputError, match=r"wall cannot be validated.*validation\.lidar"):
        split_lidar(sample(intrinsics=None))
    with pytest.raises(InputError, match="64 lines of a recorded scan"):
        split_lidar(recorded(), "64")
    assert split_lidar(sample(intrinsics=None), "random:0.1").fed.any()


def figures(predict, frame=None):
    split = split_lidar(frame or sample())
    scores = score(lambda rgb, fed, _: predict(rgb, fed), [split], num_classes=11)
    return scores.figures([f"c{i}" for i in range(11)])


def test_truth_scores_full_marks():
    truth = sample()
    edge = np.zeros((60, 120), np.float32)
    edge[10] = 1
    edge[10:, 60] = 1
    result = figures(lambda rgb, fed: HeadMaps(truth.semantic, truth.depth + 0.5, edge))
    assert result["miou"] == 1
    assert result["mae_m"] == pytest.approx(0.5)
    assert result["rmse_m"] == pytest.approx(0.5)
    assert result["boundary_f"] == pytest.approx(1)
    assert result["iou_c8"] == 1


def test_depth_beyond_100_m_counts_in_no_figure():
    near, depth = sample(focal_baseline_px_m=400.0), sample().depth
    depth[20] = 300
    far = near.with_targets(depth=depth)
    answer = np.where(depth > 100, np.float32(99), depth + 1).astype(np.float32)
    expected = figures(lambda rgb, fed: HeadMaps(None, near.depth + 1, None), near)
    result = figures(lambda rgb, fed: HeadMaps(None, answer, None), far)
    assert result["mae_m"] == pytest.approx(1)
    assert {"imae_per_km", "irmse_per_km", "rmse_m", "mae_px", "rmse_px"} <= result.keys()
    for name, value in result.items():
        assert value == pytest.approx(expected[name], rel=1e-6), name


def test_each_depth_error_has_its_own_name():
    """Half of the wall 2.5 m too far, the rest right: every figure is another number."""
    frame = sample(focal_baseline_px_m=400.0)
    answer = frame.depth.copy()
    answer[10:, :60] = 12.5
    result = figures(lambda rgb, fed: HeadMaps(None, answer, None), frame)
    by_distance = {name: result.pop(name) for name in list(result) if "return" in name}
    assert list(by_distance) == [
        f"{error}_m_return_{px}_px" for px in ("0", "1_2", "3_6") for error in ("mae", "rmse")
    ]
    assert by_distance["mae_m_return_0_px"] == pytest.approx(1.25, rel=0.01)
    assert {name: round(value, 3) for name, value in result.items()} == {
        "mae_m": 1.25,
        "rmse_m": 1.768,  # sqrt(2.5^2 / 2)
        "mae_m_0_20": 1.25,
        "rmse_m_0_20": 1.768,
        "mae_m_0_50": 1.25,
        "rmse_m_0_50": 1.768,
        "mae_m_0_10": 1.25,
        "rmse_m_0_10": 1.768,
        "median_m": 0.0,  # the lower of two errors of half of the pixels each
        "imae_per_km": 10.0,  # 1000 / 10 - 1000 / 12.5 = 20, in half of the pixels
        "irmse_per_km": 14.142,
        # A wall without edges under 64 lines: all of it is near a return.
        "mae_m_interior": 1.25,
        "rmse_m_interior": 1.768,
        "mae_px": 4.0,  # 400 / 10 - 400 / 12.5 = 8
        "rmse_px": 5.657,
    }


def test_uncertainty_is_scored_where_a_model_has_one():
    depth = sample().depth
    answer = depth + np.where(np.arange(120) < 60, np.float32(1), np.float32(4))
    scale = np.where(np.arange(120) < 60, np.float32(0.9), np.float32(3)) + np.zeros_like(depth)
    result = figures(lambda rgb, fed: HeadMaps(None, answer, None, scale))
    assert result["mae_m_confident_50"] == pytest.approx(1)
    assert result["mae_m_confident_80"] == pytest.approx((0.5 * 1 + 0.3 * 4) / 0.8)
    assert result["mae_m_confident_100"] == pytest.approx(result["mae_m"])
    assert (result["coverage_1"], result["coverage_2"]) == (0, 1)
    without = figures(lambda rgb, fed: HeadMaps(None, answer, None))
    assert not any("confident" in name or "coverage" in name for name in without)


def test_the_class_road_is_scored_against_a_mask_of_it():
    mask = np.zeros((60, 120), np.uint8)
    mask[30:] = 1
    mask[10:20] = 255
    unlabelled = np.full((60, 120), 255, np.uint8)
    frame = sample(semantic=unlabelled, road_mask=mask)
    ids = np.full((60, 120), 8, np.uint8)
    ids[25:45] = 3
    split = split_lidar(frame)
    scores = score(lambda rgb, fed, _: HeadMaps(ids, None, None), [split], num_classes=11)
    names = [f"c{i}" for i in range(11)]
    assert scores.figures(names) == {}
    assert scores.figures() == {}
    names[3] = "Road"
    assert scores.figures(names) == {"road_iou": pytest.approx(15 / 35)}


def test_a_network_of_canonical_depth_sees_it_and_answers_in_metres():
    """A fake network that answers what it is fed: the factor must come off again."""

    class Copy(torch.nn.Module):
        config = SSDNetLiteConfig(canonical_focal_px=450.0)
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
    for name, head in (("nconv", "depth"), ("enet", "semantic")):
        network = create_model(name)
        torch.nn.init.constant_(next(network.parameters()), float("nan"))
        with pytest.raises(SSDNetError, match=f"the network's {head} is not finite"):
            torch_predict(network)(truth.rgb, truth.depth, 300.0)


def test_frames_are_scored_with_their_own_focal_length():
    seen = []

    def predict(rgb, fed, focal_length_px):
        seen.append(focal_length_px)
        return HeadMaps(None, sample().depth, None)

    frames = [split_lidar(sample(), "random:0.1"), split_lidar(sample(intrinsics=None), "none")]
    score(predict, frames, num_classes=11)
    assert seen == [300.0, None]
    source = [sample(), sample(intrinsics=None)]
    network = create_model("ssdnet-lite")
    list(draw_pictures(predict, source, network, lidar=LidarInput("none"), count=2))
    assert seen == [300.0, None] * 2
