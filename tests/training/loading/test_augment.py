"""Joint augmentation keeps RGB, depth, labels and intrinsics telling the same story."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from runtime.base.errors import InputError
from runtime.contract.contract import NO_CLASS
from runtime.contract.resize import move_returns, resize_image, resize_nearest
from runtime.engine.preprocess import clean_sparse_depth
from training.datasets.sample import Sample, make_frame
from training.loading.augment import augment, take_views
from training.loading.augment_config import AugmentConfig, with_crop
from training.loading.colors import change_colors
from training.loading.depth_values import (
    PSEUDO_SKY_MARGIN_PX,
    SKY_MARGIN_PX,
    DepthTarget,
    canonical_depth,
    far_sky,
)
from training.loading.geometric import choose_crop, cut, flip, resize, scale_and_crop
from training.loading.lidar_input import draw_lidar

K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


def changed(sample, config, seed, canonical_focal_px=None, rare=()):
    target = DepthTarget(canonical_focal_px)
    return augment(sample, config, np.random.default_rng(seed), target, rare)


def plane(height=48, width=64):
    """A tilted plane whose depth, class and colour can be told from one another anywhere."""
    v, u = np.mgrid[:height, :width]
    depth = (5 + 0.25 * u + 0.1 * v).astype(np.float32)
    semantic = (u // 8 % 8).astype(np.uint8)
    rgb = np.stack([semantic * 30, v * 4, depth * 8], axis=-1).astype(np.uint8)
    frame = make_frame(rgb, "plane", intrinsics=K.copy())
    return Sample(frame, {"depth": depth, "semantic": semantic})


def with_intrinsics(sample, intrinsics):
    frame = make_frame(sample.rgb, sample.name, returns=sample.returns, intrinsics=intrinsics)
    return replace(sample, frame=frame)


def recorded(height=48, width=64):
    """The plane, measured on every third row only, each row a scan line."""
    sample = plane(height, width)
    rows = np.arange(height)[:, None] * np.ones(width, int)
    measured = rows % 3 == 0
    depth = np.where(measured, sample.depth, 0).astype(np.float32)
    line = np.where(measured, rows // 3, -1).astype(np.int16)
    scan = replace(sample.with_returns(depth), scan_line=line)
    return replace(scan, targets={"semantic": sample.semantic})


def recorded_beside_its_target(height=48, width=64):
    """The plane as semi-dense ground truth, and a LiDAR that measured 0.5 m more, elsewhere."""
    sample = plane(height, width)
    v, u = np.mgrid[:height, :width]
    depth = np.where((u + v) % 4 == 0, sample.depth, 0).astype(np.float32)
    seen = np.where((u % 4 == 1) & (v % 3 == 0), sample.depth + 0.5, 0).astype(np.float32)
    return sample.with_returns(seen).with_targets(depth=depth)


def test_flip_twice_is_the_same_and_once_moves_everything():
    sample = plane()
    once, twice = flip(sample), flip(flip(sample))
    for name in ("rgb", "depth", "semantic", "intrinsics"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(sample, name))
    assert once.semantic[3, 0] == sample.semantic[3, -1]
    assert once.depth[3, 0] == sample.depth[3, -1]
    assert (once.rgb[3, 0] == sample.rgb[3, -1]).all()
    assert once.intrinsics[0, 2] == 63 - 31.5


def test_points_in_space_survive_cut_and_resize():
    """A pixel unprojects to the same 3-D point before and after."""
    sample = plane()
    small = resize(cut(sample, 8, 16, (32, 40)), (64, 80))
    for v, u in ((10, 20), (30, 50), (63, 0)):
        # The same surface spot in the original: u' = (u + 0.5) / 2 - 0.5, then the offset.
        v0, u0 = (v + 0.5) / 2 - 0.5 + 8, (u + 0.5) / 2 - 0.5 + 16
        direction = np.linalg.inv(small.intrinsics) @ (u, v, 1)
        np.testing.assert_allclose(direction, np.linalg.inv(K) @ (u0, v0, 1), atol=1e-9)
        assert small.depth[v, u] == pytest.approx(5 + 0.25 * u0 + 0.1 * v0, abs=0.2)
        assert small.semantic[v, u] == round(u0 - 1e-9) // 8 % 8


def test_window_beyond_the_image_is_unknown():
    out = cut(plane(), -4, -6, (60, 80))
    assert (out.semantic[:4] == NO_CLASS).all()
    assert not out.depth[:, :6].any()
    assert (out.rgb[0, 0] == (124, 116, 104)).all()
    assert out.depth[4, 6] == plane().depth[0, 0]
    assert out.intrinsics[0, 2] == K[0, 2] + 6


def test_few_returns_are_drawn_as_often_as_many():
    config = AugmentConfig(lidar_missing=0, lidar_random=1, random_share=(0.002, 0.08))
    rng = np.random.default_rng(0)
    shares = [np.mean(draw_lidar(plane(), config, rng).returns > 0) for _ in range(200)]
    assert min(shares) < 0.003
    assert np.median(shares) == pytest.approx((0.002 * 0.08) ** 0.5, rel=0.3)


def test_input_and_target_recorded_apart_stay_apart_when_enlarged():
    sample = recorded_beside_its_target()
    large = resize(sample, (144, 192))
    # Every return is at the middle of the three times three pixels it was, and nowhere else.
    for name in ("returns", "depth"):
        expected = np.zeros((144, 192), np.float32)
        expected[1::3, 1::3] = getattr(sample, name)
        np.testing.assert_array_equal(getattr(large, name), expected)
    assert large.scan_line is None


@pytest.mark.parametrize("seed", range(8))
def test_all_lines_of_a_recorded_scan_are_never_fed(seed):
    """A sensor of 64 lines is asked for, but its scan is the only target there is."""
    sample = recorded()
    config = AugmentConfig(lidar_missing=0, lidar_random=0, lines=(64,))
    out = draw_lidar(sample, config, np.random.default_rng(seed))
    assert np.count_nonzero(out.returns) == np.count_nonzero(sample.depth) / 2
    # The others, less what hides behind nearer ones.
    assert np.count_nonzero(out.depth) > 0.4 * np.count_nonzero(sample.depth)


def test_lines_of_a_recorded_input_are_chosen_and_survive_every_change():
    moved = flip(resize(cut(rendered(), 2, 0, (40, 64)), (80, 128)))
    assert ((moved.scan_line >= 0) == (moved.returns > 0)).all()
    config = AugmentConfig(lidar_missing=0, lidar_random=0, lines=(64, 16))
    kept = set()
    for seed in range(8):
        out = draw_lidar(moved, config, np.random.default_rng(seed))
        lines = set(moved.scan_line[out.returns > 0])
        every = set(moved.scan_line[moved.returns > 0])
        residues = {line % 4 for line in lines}
        assert lines == {line for line in every if line % 4 in residues}
        assert len(residues) in (1, 4)
        kept.add(len(residues))
        np.testing.assert_array_equal(out.depth, moved.depth)
    assert kept == {1, 4}


@pytest.mark.parametrize("size", [(20, 31), (96, 40), (30, 100), (96, 128)], ids=str)
def test_training_resizes_as_the_engine_does(size):
    """Pictures by area where they shrink, returns one by one with their scan lines."""
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    scan = recorded()
    measured = replace(scan, frame=make_frame(noise, "scan", returns=scan.returns))
    out = resize(measured, size)
    np.testing.assert_array_equal(out.rgb, resize_image(noise, size))
    np.testing.assert_array_equal(out.depth, move_returns(measured.depth, size))
    np.testing.assert_array_equal(out.scan_line >= 0, out.depth > 0)
    dense = resize(plane(), size)
    np.testing.assert_array_equal(dense.depth, resize_nearest(plane().depth, size))
    np.testing.assert_array_equal(dense.semantic, resize_nearest(plane().semantic, size))


@pytest.mark.parametrize(("crop", "scale"), [((24, 32), 0.5), ((96, 128), 2.0), ((24, 64), 2.0)])
def test_dense_truth_under_a_wide_sky_is_resized_as_dense(crop, scale):
    """Returns that are moved one by one keep the nearer of two, and leave holes when enlarged."""
    sample = recorded_beside_its_target().with_targets(depth=plane().depth.copy())
    sample.depth[: round(0.6 * sample.size[0])] = 0  # sky
    config = AugmentConfig(crop=crop, scale=(scale, scale))
    for seed in range(8):  # the last crop may be mostly sky
        out = scale_and_crop(sample, config, np.random.default_rng(seed))
        # Columns are all ground or all sky below the horizon: no holes.
        ground = out.depth > 0
        assert not (ground[:-1] & ~ground[1:]).any()
        if scale < 1:
            known = sample.depth[sample.depth > 0]
            assert np.isin(out.depth[ground], known).all()
            np.testing.assert_array_equal(out.depth, resize_nearest(sample.depth, crop))


def test_result_has_the_crop_size_and_is_reproducible():
    config = AugmentConfig(crop=(40, 56))
    for make in (plane, recorded, recorded_beside_its_target):
        sample = make()
        a, b = (changed(sample, config, 7) for _ in range(2))
        other = changed(sample, config, 8)
        assert a.rgb.shape == (40, 56, 3)
        assert a.depth.dtype == a.returns.dtype == np.float32
        for name in ("rgb", "depth", "returns", "semantic"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert not np.array_equal(a.rgb, other.rgb)
        for name in ("rgb", "depth", "semantic"):  # the input is not touched
            np.testing.assert_array_equal(getattr(sample, name), getattr(make(), name))


def test_a_road_mask_is_changed_like_the_labels():
    """Mirrored, cut beyond the picture, resized: its pixels stay those of the class under them."""
    sample = plane()
    sample = sample.with_targets(road_mask=(sample.semantic == 3).astype(np.uint8))
    config = AugmentConfig(crop=(60, 80), scale=(0.7, 1.5))
    for seed in range(4):
        out = changed(sample, config, seed)
        expected = np.where(out.semantic == NO_CLASS, NO_CLASS, out.semantic == 3)
        assert (out.semantic == NO_CLASS).any()
        np.testing.assert_array_equal(out.targets["road_mask"], expected)


def test_gray_removes_the_colour():
    gray = AugmentConfig(brightness=0, contrast=0, hue_deg=0, gray=1, blur=0, noise=0)
    out = change_colors(plane().rgb, gray, np.random.default_rng(0)).astype(int)
    assert np.abs(out - out[..., :1]).max() <= 1
    expected = cv2.cvtColor(plane().rgb, cv2.COLOR_RGB2GRAY)
    assert np.abs(out[..., 0] - expected).max() <= 2


@pytest.mark.parametrize("max_depth_m", [30.0, 80.0, 300.0])
def test_canonical_returns_beyond_the_range_are_those_of_the_engine(max_depth_m):
    fed = np.zeros((48, 64), np.float32)
    fed[0, :5] = 40, 240, 260, 500, 655.35
    sample = with_intrinsics(plane(), np.diag([200.0, 200.0, 1.0])).with_returns(fed)
    out = canonical_depth(sample, 100.0, max_depth_m).returns
    engine, *_ = clean_sparse_depth(fed, max_depth_m=2 * max_depth_m)
    np.testing.assert_allclose(out, engine / 2)
    assert np.count_nonzero(out) == (4 if max_depth_m == 300 else 2)


@pytest.mark.parametrize(("known", "factor"), [(True, 200 / (50 * 2)), (False, 1 / 2)])
def test_augmented_samples_are_in_canonical_depth(known, factor):
    """Magnified by 2, of 50 px or as if of 200 px: all depth is as the canonical camera's."""
    sample = recorded_beside_its_target()
    if not known:
        sample = with_intrinsics(sample, None)
    config = AugmentConfig(crop=(32, 32), scale=(2.0, 2.0), lidar_missing=0, lidar_random=0)
    metres = changed(sample, config, 3)
    canonical = changed(sample, config, 3, canonical_focal_px=200.0)
    assert metres.depth.any()
    assert metres.returns.any()
    np.testing.assert_allclose(canonical.depth, metres.depth * factor, rtol=1e-6)
    np.testing.assert_allclose(canonical.returns, metres.returns * factor, rtol=1e-6)
    np.testing.assert_array_equal(canonical.rgb, metres.rgb)


def test_sky_is_far_where_nothing_was_measured():
    depth, fed = np.zeros((2, 3, 40), np.float32)
    depth[1, 2], fed[1, 3] = 7, 5
    semantic = np.full((3, 40), 4, np.uint8)
    semantic[:, 30:] = 3
    frame = make_frame(np.zeros((3, 40, 3), np.uint8), "sky", returns=fed)
    sample = Sample(frame, {"depth": depth, "semantic": semantic})

    def sky_columns(sample):
        """Columns of the middle row whose depth is the sky's."""
        return set(np.flatnonzero(far_sky(sample, 4, 80.0).depth[1] == 80))

    inner = set(range(30 - SKY_MARGIN_PX))
    assert sky_columns(sample) == inner - {2, 3}
    assert sky_columns(sample.with_returns(None)) == inner - {2}
    made_by_a_network = replace(sample, weights={"semantic": 0.2})
    assert sky_columns(made_by_a_network) == set(range(30 - PSEUDO_SKY_MARGIN_PX)) - {2, 3}
    out = far_sky(sample, 4, 80.0)
    assert out.depth.dtype == np.float32
    assert out.depth[1, 2] == 7
    assert out.returns is fed
    assert (depth == 80).sum() == 0


def rendered(height=48, width=64):
    """The plane's dense truth, and a scan of it whose lines are known, 0.5 m too far."""
    scan = recorded(height, width)
    seen = np.where(scan.depth > 0, scan.depth + 0.5, 0).astype(np.float32)
    return replace(plane(height, width).with_returns(seen), scan_line=scan.scan_line)


ALWAYS = AugmentConfig(lidar_missing=0, lidar_random=0, lines=(64,))


def test_128_lines_are_drawn_from_dense_truth_and_are_64_of_a_recorded_scan():
    config = replace(ALWAYS, lines=(128,))
    camera = np.array([[500.0, 0, 159.5], [0, 500.0, 40.0], [0, 0, 1]])
    sample = with_intrinsics(rendered(240, 320), camera)
    seen = draw_lidar(sample, config, np.random.default_rng(0)).returns
    known = seen > 0
    np.testing.assert_allclose(seen[known], sample.depth[known], atol=0.15)  # not + 0.5
    drawn = draw_lidar(
        replace(sample.with_returns(None), scan_line=None), ALWAYS, np.random.default_rng(0)
    )
    assert known.sum() > 1.7 * np.count_nonzero(drawn.returns)
    for scan in (recorded(), recorded_beside_its_target(), with_intrinsics(rendered(), None)):
        thin = scan.with_targets(depth=np.where(scan.depth % 4 < 1, scan.depth, 0))
        of_128, of_64 = (
            draw_lidar(thin, item, np.random.default_rng(0)).returns for item in (config, ALWAYS)
        )
        np.testing.assert_array_equal(of_128, of_64)


@pytest.mark.parametrize("fault", ["lidar_misaligned", "lidar_dropout", "lidar_absorbed"])
def test_each_fault_of_the_lidar_changes_the_input_alone(fault):
    sample, config = rendered(), replace(ALWAYS, **{fault: 1.0})
    good, bad = (draw_lidar(sample, item, np.random.default_rng(0)) for item in (ALWAYS, config))
    np.testing.assert_array_equal(bad.depth, good.depth)
    lost, new = good.returns > bad.returns, bad.returns > good.returns
    assert lost.any()
    assert new.any() == (fault == "lidar_misaligned")  # moved; otherwise the rest stays
    if fault == "lidar_dropout":
        assert not bad.returns[:, lost.any(axis=0)].any()
    if fault == "lidar_absorbed":
        assert len(set(sample.semantic[lost])) == 1


def test_the_crop_with_most_pixels_of_the_rare_classes_is_chosen():
    labels = np.zeros((8, 8), np.uint8)
    labels[6:, 6:], labels[0, 0] = 2, 3
    offsets = [(2, 2), (0, 0), (4, 4), (5, 5)]
    assert choose_crop(labels, (4, 4), offsets, (2,)) == (4, 4)  # the first of two that tie
    assert choose_crop(labels, (4, 4), offsets, (3,)) == (0, 0)
    assert choose_crop(labels, (4, 4), offsets, (9,)) == (2, 2)
    assert choose_crop(labels, (12, 12), [(4, 4), (-4, -4)], (2, 3)) == (-4, -4)


def test_crops_chosen_for_a_rare_class_show_it_more_often():
    """The chosen crop shows the class if any of its candidates does."""
    sample = plane(64, 96)
    labels = np.zeros((64, 96), np.uint8)
    labels[12:14, 20:22] = 2
    sample = sample.with_targets(semantic=labels)

    def share(**changes):
        config = AugmentConfig(crop=(32, 48), scale=(1.0, 1.0), flip=0.0, **changes)
        crops = [changed(sample, config, seed, rare=(2,)) for seed in range(200)]
        return np.mean([(crop.semantic == 2).any() for crop in crops])

    by_chance = share()
    assert share(rare_crops=1.0, crop_candidates=1) == pytest.approx(by_chance, abs=0.1)
    assert share(rare_crops=1.0) == pytest.approx(1 - (1 - by_chance) ** 4, abs=0.1)
    assert by_chance + 0.1 < share(rare_crops=0.5) < share(rare_crops=1.0) - 0.1


@pytest.mark.parametrize(("size", "crop"), [
    ((125, 414), (96, 144)), ((375, 1242), (320, 480)), ((640, 256), (320, 256)),
    ((20, 20), (32, 32)),
])  # fmt: skip
def test_the_crop_follows_the_smallest_frame(size, crop):
    assert with_crop(AugmentConfig(), size).crop == crop
    stated = AugmentConfig(crop=(64, 64))
    assert with_crop(stated, size) == stated


def test_a_crop_that_is_too_small_for_two_views_is_refused():
    with pytest.raises(InputError, match=r"crop was set to \[96, 144\] .*; with pair_shift = 32"):
        with_crop(AugmentConfig(pair_shift=32), (125, 414))


def test_a_faulty_camera_spoils_the_picture_alone_and_perhaps_one_view_alone():
    sample, faulty = recorded(64, 128), AugmentConfig(crop=(64, 128), flip=0.0, camera_fault=1.0)
    found, clean = (
        changed(sample, config, 3) for config in (faulty, replace(faulty, camera_fault=0.0))
    )
    assert np.abs(found.rgb.astype(int) - clean.rgb).mean() > 2
    assert np.array_equal(found.returns, clean.returns)
    assert np.array_equal(found.depth, clean.depth)
    pairs = AugmentConfig(crop=(80, 112), pair_shift=8, pair_camera_fault=1.0)
    first, second, (top, left) = take_views(
        recorded(88, 120), pairs, np.random.default_rng(4), step=4
    )
    seen = cut(recorded(88, 120), top, left, (80, 112))
    assert np.array_equal(first.rgb, recorded(88, 120).rgb[:80, :112])
    assert np.abs(second.rgb.astype(int) - seen.rgb).mean() > 2
    assert np.array_equal(second.returns, seen.returns)
