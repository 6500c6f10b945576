"""The mixture is reproducible from any sample on and keeps its proportions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from training.datasets.sample import Sample, make_frame
from training.loading.augment_config import PAIR_STEP_PX, AugmentConfig
from training.loading.batch import Batch, Drawn
from training.loading.colors import move_histograms
from training.loading.depth_values import DepthTarget
from training.loading.mixture import Mixture, MixturePart
from training.losses.agreement import semantic_consistency_loss


def mix(parts, **options):
    plain = {"depth": DepthTarget(), "pair_step": PAIR_STEP_PX, "rare": ()}
    return Mixture(parts=parts, **plain | options)


def numbered(length, offset, noise=0):
    """Frames whose colour tells their number, up to `noise` brighter; no LiDAR."""
    images = [
        offset + index + np.random.default_rng(index).integers(0, noise + 1, (40, 40, 3))
        for index in range(length)
    ]
    labels = {"semantic": np.zeros((40, 40), np.uint8)}
    return [
        Sample(make_frame(image.astype(np.uint8), str(offset + index)), labels)
        for index, image in enumerate(images)
    ]


def mixture(length=400, seed=0):
    config = AugmentConfig(crop=(32, 32))
    parts = [MixturePart(numbered(10, 0), 3.0, config), MixturePart(numbered(20, 100), 1.0, config)]
    return mix(parts, length=length, seed=seed)


def sample(index, **options):
    (view,) = mixture(**options)[index].views
    return view


def test_sample_is_a_function_of_seed_and_index():
    a, b = sample(123), sample(123)
    assert np.array_equal(a.rgb, b.rgb)
    assert a.name == b.name
    assert [sample(i, seed=1).name for i in range(20)] != [sample(i).name for i in range(20)]


def test_proportions_and_passes():
    names = [int(sample(i).name) for i in range(400)]
    first = [name for name in names if name < 100]
    assert len(first) == pytest.approx(300, abs=30)
    # Every pass shows each of the ten frames once.
    for start in range(0, len(first) - 10, 10):
        assert sorted(first[start : start + 10]) == list(range(10))


def test_colours_move_towards_those_of_another_image():
    still = dict.fromkeys(("brightness", "contrast", "saturation", "hue_deg", "blur", "gray"), 0)

    def means(restyle):
        config = AugmentConfig((32, 32), (1.0, 1.0), noise=0, restyle=restyle, **still)
        parts = [
            MixturePart(each, 1.0, config) for each in (numbered(5, 0, 40), numbered(5, 200, 40))
        ]
        mixed = mix(parts, length=30, seed=1)
        return {int(mixed[i].views[0].rgb.mean().round(-1)) for i in range(30)}

    assert means(0.0) == {20, 220}
    moved = means(1.0)
    assert len(moved) > 6
    assert (min(moved), max(moved)) == (20, 220)
    dark, bright = (numbered(5, offset, 40)[0].rgb for offset in (0, 200))
    np.testing.assert_array_equal(move_histograms(dark, bright, 0.0), dark)
    moved = move_histograms(dark, bright, 1.0)
    levels = [np.sort(each[::4, ::4, 1].ravel()).astype(int) for each in (moved, bright)]
    assert np.abs(levels[0] - levels[1]).max() <= 6
    np.testing.assert_array_equal(move_histograms(dark, dark, 1.0)[::4, ::4], dark[::4, ::4])


def street():
    """The upper half sky, class 0, the lower a road, class 3, at 20 m; f = 50 px."""
    depth = np.zeros((40, 40), np.float32)
    depth[20:] = 20
    intrinsics = np.array([[50.0, 0, 20], [0, 50.0, 20], [0, 0, 1]])
    targets = {"depth": depth, "semantic": np.where(depth > 0, 3, 0).astype(np.uint8)}
    frame = make_frame(np.zeros((40, 40, 3), np.uint8), "street", intrinsics=intrinsics)
    return Sample(frame, targets)


def drawn(data, canonical_focal_px=None):
    config = AugmentConfig(crop=(40, 40), scale=(1.0, 1.0), lidar_missing=0)
    depth = DepthTarget(canonical_focal_px, 0 if data else None, **data)
    (view,) = mix([MixturePart([street()], 1.0, config)], length=1, seed=0, depth=depth)[0].views
    return {name: set(getattr(view, name).flat) for name in ("depth", "returns")}


def test_the_recipe_sets_the_unit_of_the_depth():
    plain = drawn({})
    assert plain["depth"] == {0, 20}
    # Far in the target only: no LiDAR measures the sky. Close to another label it stays unknown.
    far = drawn({"sky_depth_m": 90.0})
    assert far["depth"] == {0, 20, 90}
    assert far["returns"] == plain["returns"]
    # The depth of the sky is canonical already.
    both = drawn({"sky_depth_m": 100.0}, canonical_focal_px=75.0)
    assert both["depth"] == {0, 30, 100}
    assert 28 < max(both["returns"]) < 32


def test_targets_are_batched_and_unlabelled_where_a_set_lacks_them():
    plain = street().with_returns(np.zeros((40, 40), np.float32))
    mask = np.where(np.arange(40)[:, None] < 20, 0, 1) * np.ones((40, 40), np.uint8)
    masked = replace(plain, targets={"road_mask": mask.astype(np.uint8)}, weights={"semantic": 0.2})
    batch = Batch.collate([Drawn((plain,)), Drawn((masked,))], ("depth", "road_mask", "semantic"))
    assert batch.targets["road_mask"].dtype == torch.uint8
    assert (batch.targets["road_mask"][0] == 255).all()
    assert batch.targets["road_mask"][1].tolist() == mask.tolist()
    assert (batch.targets["semantic"][1] == 255).all()
    assert not batch.targets["depth"][1].any()
    assert batch.weights["semantic"].tolist() == pytest.approx([1, 0.2])
    assert batch.weights["depth"].tolist() == [1, 1]


def textured(index):
    """A frame whose pixels are all different, with depth everywhere and labels."""
    rng = np.random.default_rng(index)
    rgb = rng.integers(0, 256, (300, 320, 3), dtype=np.uint8)
    depth = rng.uniform(20, 60, (300, 320)).astype(np.float32)
    labels = rng.integers(0, 11, (300, 320)).astype(np.uint8)
    targets = {"depth": depth, "semantic": labels, "road_mask": (labels == 3).astype(np.uint8)}
    intrinsics = np.array([[900.0, 0, 160], [0, 900, 10], [0, 0, 1]])
    return Sample(make_frame(rgb, "", intrinsics=intrinsics), targets)


TEXTURED = [textured(index) for index in range(3)]


def pairs(pair_step=PAIR_STEP_PX, **options):
    config = AugmentConfig(
        crop=(128, 160), pair_shift=32, blur=0, noise=0, lidar_missing=0, **options
    )
    parts = [MixturePart(TEXTURED, 1.0, config)]
    return mix(parts, length=24, seed=3, pair_step=pair_step)


def maps_of(view):
    return {"rgb": view.rgb, "returns": view.returns, **view.targets}


def test_two_views_show_the_same_frame_from_the_offset_on():
    drawn = [pairs()[index] for index in range(24)]
    offsets = {frame.offset for frame in drawn}
    assert len(offsets) > 10
    assert all(part % 4 == 0 and part <= 32 for offset in offsets for part in offset)
    for views, (rows, columns) in drawn:
        first, second = map(maps_of, views)
        assert first.keys() == {"rgb", "returns", "depth", "semantic", "road_mask"}
        for key, values in first.items():
            assert values.shape[:2] == (128, 160)
            shared = second[key][: 128 - rows, : 160 - columns]
            assert np.array_equal(values[rows:, columns:], shared), key


def test_a_batch_has_all_first_views_before_all_second_ones():
    drawn = [pairs()[index] for index in range(2)]
    batch = Batch.collate(drawn, ("depth",))
    order = [frame.views[view] for view in range(2) for frame in drawn]
    for index, view in enumerate(order):
        assert np.array_equal(batch.rgb[index].permute(1, 2, 0), view.rgb)
        assert np.array_equal(batch.targets["depth"][index], view.depth)
    assert batch.pair.offset.tolist() == [list(frame.offset) for frame in drawn]
    assert torch.equal(torch.cat(batch.pair[1:]), batch.sparse_depth)
    assert len(batch.names) == 2


@pytest.mark.parametrize("stride", [4, 8, 16])
def test_a_perfect_network_agrees_with_itself_whatever_the_grid_of_its_classes(stride):
    """The means of the cells of its grid are the answer: equal where the cells are the same."""
    for index in range(12):
        batch = Batch.collate([pairs(pair_step=stride)[index]], ())
        cells = F.avg_pool2d(batch.rgb.float(), stride).chunk(2)
        loss = semantic_consistency_loss(*cells, batch.pair, side=stride)
        assert loss.item() == pytest.approx(0)


@pytest.mark.parametrize(("missing", "false"), [(1.0, 0.0), (0.0, 1.0), (0.0, 0.0)])
def test_the_lidar_of_the_second_view_is_missing_or_has_false_returns(missing, false):
    for index in range(6):
        views, (rows, columns) = pairs(pair_lidar_missing=missing, pair_lidar_false=false)[index]
        first, second = (view.returns for view in views)
        assert first.any()
        assert (not second.any()) == bool(missing)
        changed = first[rows:, columns:] != second[: 128 - rows, : 160 - columns]
        assert bool(changed.any()) == bool(missing or false)
        assert (views[0].depth[rows:, columns:][changed] > 0).all()
        if false:
            assert 0 < int(changed.sum()) < 20


def test_a_world_of_another_scale_looks_the_same_and_is_farther():
    plain, scaled = pairs(), pairs(world_scale=(1.5, 1.5))
    for index in range(6):
        for before, after in zip(plain[index].views, scaled[index].views, strict=True):
            assert before.returns.any()
            assert np.array_equal(after.rgb, before.rgb)
            assert np.array_equal(after.semantic, before.semantic)
            assert np.allclose(after.depth, 1.5 * before.depth)
            assert np.allclose(after.returns, 1.5 * before.returns)
    factors = [
        drawn.views[0].depth.max() / before.views[0].depth.max()
        for drawn, before in zip(pairs(world_scale=(0.5, 2.0)), plain, strict=True)
    ]
    assert 0.5 <= min(factors) < 0.8
    assert 1.25 < max(factors) <= 2


def test_a_scaled_world_keeps_the_range_of_returns_and_the_sky():
    frame, above = TEXTURED[0], (np.arange(300) < 150)[:, None]
    labels = np.where(above, np.uint8(0), np.uint8(1) + frame.semantic % 10)
    frame = frame.with_targets(semantic=labels, depth=np.where(above, np.float32(0), frame.depth))
    config = AugmentConfig(
        crop=(128, 160), scale=(0.5, 0.5), lidar_missing=0, world_scale=(2.0, 2.0)
    )
    depth = DepthTarget(sky=0, sky_depth_m=100.0, max_depth_m=90.0)
    (view,) = mix([MixturePart([frame], 1.0, config)], length=1, seed=3, depth=depth)[0].views
    assert view.returns.max() == 90
    assert view.depth.max() > 110
    inner = view.semantic[2:-2] == 0
    assert np.median(view.depth[2:-2][inner]) == 100
