"""Building blocks of the pictures: noise, painted stripes, meshes."""

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from training.scenes.names import SceneClass
from training.scenes.textures.patterns import Stripe, band, paint_cover
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, polygon
from training.scenes.things.vehicles import make_bus, make_car, make_truck, make_van

PLAIN = Look(SurfaceKind.PLAIN, (0.5, 0.4, 0.3), SceneClass.MISC, (2.0, 3.0))


def f32(*values):
    return np.array(values, np.float32)


def test_band_is_the_share_of_the_pixel_inside():
    x = np.random.default_rng(0).uniform(-2, 2, 50)
    width = np.random.default_rng(1).uniform(0.01, 3, 50)
    fine = np.linspace(-0.5, 0.5, 20001)
    slow = [(np.abs(a + w * fine) < 0.7).mean() for a, w in zip(x, width, strict=True)]
    assert np.allclose(band(x, 0.7, width), slow, atol=2e-4)


def test_a_dashed_line_is_painted_where_its_dashes_are():
    dashes = Stripe("s", 1.0, 0.1, 10.0, 40.0, period=9.0, painted=1 / 3)
    s = f32(9.0, 10.5, 12.5, 14.0, 18.0, 19.5, 39.0, 41.0)
    sharp = np.full_like(s, 0.01)
    cover = paint_cover(dashes, s, np.full_like(s, 1.0), sharp, sharp)
    assert np.round(cover).tolist() == [0, 1, 1, 0, 0, 1, 1, 0]
    assert not paint_cover(dashes, s, np.full_like(s, 1.2), sharp, sharp).any()
    # From far away a pixel holds whole dashes and shows their share.
    far = paint_cover(dashes, f32(25.0), f32(1.0), f32(30.0), f32(0.01))
    assert far[0] == pytest.approx(1 / 3, abs=0.02)
    # A crossing runs across the street.
    zebra = Stripe("d", 20.0, 1.5, -4.0, 4.0, period=1.0, painted=0.5)
    d, at, sharp = f32(-3.8, -3.2, -2.8, 0.3, 0.7), f32(*[20.5] * 5), f32(*[0.01] * 5)
    assert np.round(paint_cover(zebra, at, d, sharp, sharp)).tolist() == [1, 0, 1, 1, 0]
    assert not paint_cover(zebra, at + 1.5, d, sharp, sharp).any()


def test_a_mesh_turns_and_keeps_its_texture():
    flat = polygon([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], PLAIN)
    moved = flat.moved(heading=np.pi / 2, offset=(10, 0, 1))
    assert np.allclose(moved.positions[0, 1], (10, 2, 1), atol=1e-6)
    assert np.array_equal(moved.texture, flat.texture)
    assert np.allclose(flat.normals, (0, 0, 1))
    assert flat.params[0, :3].tolist() == [2, 3, 0]


VEHICLES = {
    make_car: (SceneClass.CAR, (3.7, 5.2), (1.3, 1.9)),
    make_van: (SceneClass.VAN, (4.5, 5.7), (2.0, 2.6)),
    make_truck: (SceneClass.TRUCK, (6.0, 11.0), (2.6, 4.1)),
    make_bus: (SceneClass.TRUCK, (10.5, 11.5), (2.8, 4.2)),
}


@pytest.mark.parametrize("make", VEHICLES)
def test_vehicles_have_their_size_and_stand_on_the_road(make):
    label, length, height = VEHICLES[make]
    for seed in range(8):
        mesh = make(np.random.default_rng(seed))
        low, high = mesh.positions.min(axis=(0, 1)), mesh.positions.max(axis=(0, 1))
        assert length[0] < high[0] - low[0] < length[1]
        assert height[0] < high[2] < height[1]
        assert abs(low[2]) < 0.02
        assert (mesh.label == label).all()
