"""Clouds against the projection: every point falls back into its own pixel."""

import dataclasses

import numpy as np
import pytest

from runtime import Predictor, project_points
from runtime.base.errors import InputError
from runtime.geometry.point_cloud import depth_to_cloud, thin_to_voxels

K = np.array([[60.0, 0.5, 31.5], [0, 62, 20.25], [0, 0, 1]])
SIZE = (48, 64)


def depth_map(seed=0):
    depth = np.random.default_rng(seed).uniform(1, 80, SIZE).astype(np.float32)
    depth[0, :5] = 0, -1, np.nan, np.inf, -np.inf
    return depth


def test_points_fall_back_into_their_pixels():
    depth = depth_map()
    cloud = depth_to_cloud(depth, K)
    assert cloud.points.dtype == np.float32
    assert cloud.points.shape == (48 * 64 - 5, 3)
    assert cloud.rgb is cloud.semantic is None
    back = project_points(cloud.points, K, np.eye(4), SIZE)
    depth[0, :5] = 0
    np.testing.assert_allclose(back, depth, rtol=1e-6)
    np.testing.assert_array_equal(cloud.points[:, 2], depth[cloud.rows, cloud.columns])


def test_colours_and_labels_are_those_of_the_pixels_and_edges_have_no_point():
    rng = np.random.default_rng(1)
    rgb = rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    semantic = rng.integers(0, 9, SIZE, dtype=np.uint8)
    boundary = rng.random(SIZE, dtype=np.float32)
    options = {"rgb": rgb, "semantic": semantic, "boundary": boundary}
    cloud = depth_to_cloud(depth_map(), K, **options)
    at = cloud.rows, cloud.columns
    np.testing.assert_array_equal(cloud.rgb, rgb[at])
    np.testing.assert_array_equal(cloud.semantic, semantic[at])
    assert (boundary[at] <= 0.25).all()
    assert len(cloud.points) == (boundary[depth_map() > 0] <= 0.25).sum() - (
        boundary[0, 3] <= 0.25  # infinity
    )
    assert len(depth_to_cloud(depth_map(), K, **options, edge_boundary=None).points) == 48 * 64 - 5
    for bad in ({"rgb": rgb.astype(float)}, {"rgb": rgb[1:]}, {"semantic": semantic[..., None]}):
        with pytest.raises(InputError, match=next(iter(bad))):
            depth_to_cloud(depth_map(), K, **bad)


def test_a_prediction_gives_its_cloud(model_file, make_frame):
    rgb, sparse_depth = make_frame()
    with Predictor(model_file(), threads=1) as predictor:
        prediction = predictor.predict(rgb, sparse_depth)
        cloud, kept = prediction.points(K, rgb), prediction.boundary <= 0.25
        np.testing.assert_array_equal(cloud.points[:, 2], prediction.depth[kept])
        np.testing.assert_array_equal(cloud.rgb, rgb[kept])
        np.testing.assert_array_equal(cloud.semantic, prediction.semantic[kept])
        assert len(prediction.points(K, edge_boundary=None).points) == 48 * 64
        rgb[5, 5] = 0  # boundary is NaN there
        with pytest.raises(InputError, match="boundary_not_finite"):
            predictor.predict(rgb, sparse_depth).points(K)


def test_the_boundary_of_a_model_without_classes_is_not_halved():
    """Every pixel was an edge where it says less than even odds."""
    depth, boundary = np.full((8, 8), 5, np.float32), np.full((8, 8), 0.3, np.float32)
    assert len(depth_to_cloud(depth, K, boundary=boundary).points) == 64
    assert len(depth_to_cloud(depth, K, boundary=2 * boundary).points) == 0
    assert len(depth_to_cloud(depth, K, boundary=boundary, edge_boundary=0.25).points) == 0
    labels = np.zeros((8, 8), np.uint8)
    assert len(depth_to_cloud(depth, K, boundary=boundary, semantic=labels).points) == 0


def test_the_sky_has_no_points_unless_asked_for(model_file, make_frame, contract):
    dark, red = contract.classes
    sky = dataclasses.replace(contract, classes=(dark, dataclasses.replace(red, name="Sky")))
    with Predictor(model_file(contract=sky), threads=1) as predictor:
        prediction = predictor.predict(*make_frame())
    edges = prediction.boundary <= 0.25
    assert 0 < (prediction.semantic[edges] == 1).sum() < edges.sum()
    assert len(prediction.points(K).points) == (edges & (prediction.semantic == 0)).sum()
    assert len(prediction.points(K, keep_sky=True).points) == edges.sum()


def test_points_of_a_large_share_of_uncertainty_are_left_out():
    depth = np.abs(np.nan_to_num(depth_map(), posinf=1, neginf=1)) + 1
    uncertainty = np.random.default_rng(2).uniform(0, 20, SIZE).astype(np.float32)
    cloud = depth_to_cloud(depth, K, uncertainty=uncertainty, max_uncertainty=0.2)
    kept = uncertainty <= 0.2 * depth
    np.testing.assert_array_equal(cloud.uncertainty, uncertainty[kept])
    assert 0 < len(cloud.points) < kept.size
    for options in ({"max_uncertainty": 0.2}, {"uncertainty": uncertainty, "max_uncertainty": -1}):
        with pytest.raises(InputError, match="max_uncertainty"):
            depth_to_cloud(depth, K, **options)


def test_of_each_cube_the_surest_point_is_kept():
    rng = np.random.default_rng(3)
    depth = np.full(SIZE, 10, np.float32) + rng.uniform(-0.4, 0.4, SIZE).astype(np.float32)
    uncertainty = rng.uniform(0, 1, SIZE).astype(np.float32)
    whole = depth_to_cloud(depth, K, uncertainty=uncertainty)
    thin = thin_to_voxels(whole, 1.0)
    best = {}
    for index, point in enumerate(whole.points):
        cube = tuple(np.floor(point))
        if cube not in best or uncertainty.flat[index] < uncertainty.flat[best[cube]]:
            best[cube] = index
    chosen = sorted(best.values())
    assert 10 < len(chosen) < 400
    np.testing.assert_array_equal(thin.points, whole.points[chosen])
    np.testing.assert_array_equal(thin.rows * SIZE[1] + thin.columns, chosen)
    first = thin_to_voxels(depth_to_cloud(depth, K), 1.0)
    assert len(first.points) == len(thin.points)
    assert first.rows[0] == first.columns[0] == 0, "without uncertainty the first"
    nothing = depth_to_cloud(0 * depth, K, uncertainty=uncertainty)
    assert len(thin_to_voxels(nothing, 1.0).points) == 0
    with pytest.raises(InputError, match="voxel_m"):
        thin_to_voxels(whole, 0)
