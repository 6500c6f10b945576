"""What a frame takes from another one."""

import numpy as np
import pytest

from training.datasets.camvid import CamVidRecipe
from training.datasets.sample import IGNORE, Sample
from training.datasets.virtual_kitti import RenderedRecipe
from training.loading.augment import AugmentConfig
from training.loading.domain_mixing import MAX_BAND, paste_things, swap_style
from training.loading.mixture import as_tensors
from training.loading.open_dataset import open_mixture
from training.recipe import DataRecipe, ModelRecipe

SIZE = (60, 80)
ROAD, POLE, CAR = 3, 2, 8


def texture(seed, low, high):
    rng = np.random.default_rng(seed)
    return rng.integers(low, high, (*SIZE, 3), dtype=np.uint8)


class Widest:
    """Draws the upper end."""

    def uniform(self, low, high):
        return high


def test_the_slow_colours_are_the_others_and_the_fine_ones_stay():
    day, dusk = texture(0, 100, 160), texture(1, 20, 60)
    swapped = swap_style(day, dusk, np.random.default_rng(0))
    np.testing.assert_allclose(swapped.mean((0, 1)), dusk.mean((0, 1)), atol=1)
    fine = [np.diff(image.astype(float), axis=1) for image in (day, swapped)]
    assert np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1] > 0.99


def test_its_own_style_changes_nothing():
    day = texture(0, 0, 256)
    assert np.abs(swap_style(day, day, np.random.default_rng(0)).astype(int) - day).max() <= 1


def test_only_amplitudes_of_the_band_are_swapped():
    day, dusk = (np.kron(texture(seed, 60, 180), np.ones((5, 5, 1), np.uint8)) for seed in (0, 1))
    spectra = [np.fft.fft2(image.astype(float), axes=(0, 1)) for image in (day, dusk)]
    swapped = np.fft.fft2(swap_style(day, dusk, Widest()).astype(float), axes=(0, 1))
    half = int(MAX_BAND * day.shape[0])
    assert half > 2
    frequency = [np.abs(np.fft.fftfreq(side, 1 / side)) for side in day.shape[:2]]
    inside = (frequency[0][:, None] <= half) & (frequency[1][None] <= half)
    rounding = 0.5 * np.sqrt(day[..., 0].size) * 4
    for place, wanted in ((inside, spectra[1]), (~inside, spectra[0])):
        difference = np.abs(np.abs(swapped[place]) - np.abs(wanted[place]))
        assert np.percentile(difference, 90) < rounding
    np.testing.assert_allclose(np.angle(swapped[inside] / spectra[0][inside]), 0, atol=0.2)


def street(**changes):
    """A road 30 m away, measured on every third row; fed on every sixth."""
    depth, fed = np.zeros(SIZE, np.float32), np.zeros(SIZE, np.float32)
    depth[::3], fed[::6] = 30, 30
    values = {"depth": depth, "sparse_depth": fed, "semantic": np.full(SIZE, ROAD, np.uint8)}
    values |= {"road_mask": np.ones(SIZE, np.uint8), "rgb": np.zeros((*SIZE, 3), np.uint8)}
    return Sample(intrinsics=None, name="street", **(values | changes))


def things(pole_m=10.0):
    """A pole of 40 x 3 pixels, and a car that is not asked for."""
    semantic = np.full(SIZE, IGNORE, np.uint8)
    depth = np.full(SIZE, 50.0, np.float32)
    semantic[10:50, 20:23], depth[10:50, 20:23] = POLE, pole_m
    semantic[40:50, 50:70], depth[40:50, 50:70] = CAR, 5.0
    rgb = np.full((*SIZE, 3), 200, np.uint8)
    return Sample(rgb, depth, semantic, None, "things")


POLE_AT = np.s_[10:50, 20:23]


def test_a_thing_brings_its_image_class_and_depth():
    before, after = street(), paste_things(street(), things(), [POLE])
    pasted = np.zeros(SIZE, bool)
    pasted[POLE_AT] = True
    assert (after.rgb[pasted] == 200).all()
    assert (after.semantic[pasted] == POLE).all()
    assert (after.depth[pasted] == 10).all()
    assert (after.road_mask[pasted] == 0).all()
    for name in ("rgb", "semantic", "depth", "sparse_depth", "road_mask"):
        np.testing.assert_array_equal(getattr(after, name)[~pasted], getattr(before, name)[~pasted])


def test_its_returns_are_at_the_scanned_pixels_alone():
    fed = paste_things(street(), things(), [POLE]).sparse_depth
    np.testing.assert_array_equal(fed > 0, street().sparse_depth > 0)
    assert (fed[12:50:6, 20:23] == 10).all()


def test_a_thing_behind_what_was_measured_is_left_out():
    before, after = street(), paste_things(street(), things(pole_m=40.0), [POLE])
    np.testing.assert_array_equal(after.semantic, before.semantic)
    np.testing.assert_array_equal(after.depth, before.depth)


def test_what_is_in_front_of_a_thing_stays():
    near = street()
    near.depth[30, :] = 2  # a wire
    after = paste_things(near, things(), [POLE])
    assert (after.semantic[30] == ROAD).all()
    assert (after.semantic[31, 20:23] == POLE).all()


def test_specks_are_left_out():
    speck = things()
    speck.semantic[10:50, 20:23] = IGNORE
    speck.semantic[10:14, 20:23] = POLE
    assert paste_things(street(), speck, [POLE]).semantic.max() == ROAD


def test_a_frame_without_depth_gets_none():
    nothing = np.zeros(SIZE, np.float32)
    after = paste_things(street(depth=nothing, sparse_depth=nothing), things(), [POLE])
    assert (after.semantic[POLE_AT] == POLE).all()
    assert not after.depth.any()
    assert not after.sparse_depth.any()


class Frames:
    """One frame; labels of the class, or of poles."""

    def __init__(self, sample):
        self._sample = sample

    def __len__(self):
        return 1

    def __getitem__(self, index):
        return self._sample


def mixed(**options):
    augment = AugmentConfig(crop=SIZE, scale=(1.0, 1.0), lidar_missing=0, flip=0, **options)
    recipe = DataRecipe(
        (CamVidRecipe(path="street"), RenderedRecipe(path="things", things=True, weight=1e-9)),
        augment=augment,
        paste_classes=("pole",),
    )
    sources = [Frames(street()), Frames(things())]
    return open_mixture(recipe, sources, length=4, model=ModelRecipe("ssdnet-lite"))


def test_a_mixture_pastes_by_its_probability():
    assert (mixed()[0]["semantic"] == ROAD).all()
    pasted = mixed(paste=1.0)[0]["semantic"].numpy()
    assert (pasted[POLE_AT] == POLE).all()
    assert set(np.unique(pasted)) == {ROAD, POLE}


def test_a_mixture_takes_over_style_by_its_probability():
    plain, styled = mixed()[0], mixed(style=1.0)[0]
    assert not bool((plain["rgb"] == styled["rgb"]).all())
    assert bool((plain["sparse_depth"] == styled["sparse_depth"]).all())
    again = mixed(style=1.0)[0]
    assert bool((again["rgb"] == styled["rgb"]).all())


def test_nothing_else_changes_when_both_are_off():
    sample = as_tensors(street())
    assert bool((mixed()[0]["depth"] == sample["depth"]).all())


@pytest.mark.parametrize("missing", ["classes", "things"])
def test_pasting_needs_classes_and_a_set_with_things(missing):
    source = RenderedRecipe(path="things", things=missing != "things")
    classes = () if missing == "classes" else ("pole",)
    with pytest.raises(ValueError, match="paste needs paste_classes, and a source with things"):
        DataRecipe((source,), augment=AugmentConfig(paste=0.5), paste_classes=classes)
