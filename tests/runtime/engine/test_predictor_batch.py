"""Several cameras with one call, and one predictor in several threads."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from runtime import InferenceError, InputError, Predictor
from runtime.recordings.bundled_stream import bundled_frames

HEADS = ("semantic", "depth", "boundary", "depth_uncertainty", "semantic_logits")


@pytest.fixture
def counted(change_run):
    """Give a function that returns the list of the batches that run from then on."""

    def count():
        batches = []
        change_run(lambda run, feed: batches.append(feed["rgb"].shape[:3]) or run())
        return batches

    return count


def assert_same(prediction, expected):
    for head in HEADS:
        np.testing.assert_array_equal(getattr(prediction, head), getattr(expected, head))
    for name in ("frame_size", "network_size", "valid", "degraded", "cleaned", "depth_returns"):
        assert getattr(prediction, name) == getattr(expected, name)


def only_one_frame(graph):
    for tensor in graph.input:
        tensor.type.tensor_type.shape.dim[0].dim_value = 1


@pytest.mark.parametrize(("sizes", "options", "edit", "runs"), [
    ([(48, 64), (40, 80), (48, 64)], {}, None, [(2, 48, 64), (1, 40, 80)]),
    ([(48, 64), (96, 128)], {"size": (40, 56)}, None, [(2, 40, 56)]),
    ([(48, 64)] * 3, {}, only_one_frame, [(1, 48, 64)] * 3),
    ([], {}, None, []),
], ids=["two sizes", "resized to one", "a file of one frame", "no frames"])  # fmt: skip
def test_frames_that_the_network_sees_at_one_size_are_one_run(
    model_file, make_frame, counted, sizes, options, edit, runs
):
    frames = [make_frame(*size, seed=seed) for seed, size in enumerate(sizes)]
    for rgb_and_depth in frames[2:]:
        rgb_and_depth[1][:] = 0
        rgb_and_depth[1][0, :3] = np.nan, np.inf, -1
    given = {} if edit is None else {"edit": edit}
    with Predictor(model_file(heads=HEADS, **given), **options) as predictor:
        expected = [predictor.predict(rgb, depth) for rgb, depth in frames]
        batches = counted()
        predictions = predictor.predict_batch(frames, stamps=range(len(frames)))
    assert batches == runs
    assert [item.stamp for item in predictions] == list(range(len(frames)))
    for prediction, alone in zip(predictions, expected, strict=True):
        assert_same(prediction, alone)


def test_each_camera_has_its_lens(model_file, make_frame, contract):
    contract = dataclasses.replace(contract, canonical_focal_px=700.0)
    frames = [make_frame(seed=1)] * 3
    with Predictor(model_file(contract=contract), focal_length_px=560.0) as predictor:
        predictions = predictor.predict_batch(frames, focal_lengths_px=[None, 700.0, 1400.0])
        for prediction, focal in zip(predictions, (560.0, 700.0, 1400.0), strict=True):
            alone = predictor.predict(*frames[0], focal_length_px=focal)
            np.testing.assert_array_equal(prediction.depth, alone.depth)
    assert not np.array_equal(predictions[0].depth, predictions[2].depth)


@pytest.mark.parametrize("model", ["ssdnet-lite", "ssdnet-nano-int8"])
def test_a_bundled_model_answers_a_batch_as_it_does_single_frames(model):
    pairs = [(f.rgb[:128, :192], f.sparse_depth[:128, :192]) for f in bundled_frames()[::10]]
    pairs[1] = pairs[1][0], np.zeros_like(pairs[1][1])
    with Predictor(model) as predictor:
        for prediction, pair in zip(predictor.predict_batch(pairs), pairs, strict=True):
            alone = predictor.predict(*pair)
            assert (prediction.semantic == alone.semantic).mean() > 0.999
            np.testing.assert_allclose(prediction.depth, alone.depth, atol=5e-3)
            np.testing.assert_allclose(prediction.boundary, alone.boundary, atol=4e-4)


def test_a_bad_frame_is_named_before_any_runs(model_file, make_frame, counted):
    good = make_frame()
    with Predictor(model_file()) as predictor:
        batches = counted()
        for frames, options, named in [
            ([good, (good[0], good[1][:-1]), good], {}, "frame 1 of 3: sparse_depth"),
            ([good, (good[0],), good], {}, r"frame 1 of 3 must be \(rgb, sparse_depth\)"),
            ([good, None, good], {}, "frame 1 of 3"),
            (None, {}, r"frames must be \(rgb, sparse_depth\)"),
            ([good, good], {"stamps": [1]}, "each of 2"),
            ([good], {"focal_lengths_px": 700.0}, "one entry for each of 1 frames, got 700.0"),
            ([good], {"focal_lengths_px": [-1.0]}, "frame 0 of 1: focal_length_px"),
        ]:
            with pytest.raises(InputError, match=named):
                predictor.predict_batch(frames, **options)
        assert batches == []


def test_a_batch_that_fails_says_of_what(model_file, make_frame):
    predictor = Predictor(model_file(only_runs_at=(64, 64)), warmup=0)
    with pytest.raises(InferenceError, match="2 frames of 48 x 64"):
        predictor.predict_batch([make_frame(), make_frame()])
    predictor.close()
    with pytest.raises(InferenceError, match="closed"):
        predictor.predict_batch([make_frame()])


def test_threads_that_share_a_predictor_get_their_own_answers(model_file, make_frame):
    """Eight threads predict frames of three sizes at once, single and in batches."""
    sizes = [(48, 64), (64, 96), (96, 80)]
    frames = [make_frame(*sizes[seed % 3], seed=seed) for seed in range(12)]
    with Predictor(model_file(heads=HEADS), size=(40, 56)) as predictor:
        expected = [predictor.predict(*frame) for frame in frames]

        def work(number):
            random = np.random.default_rng(number)
            for _ in range(12):
                chosen = random.integers(len(frames), size=int(random.integers(1, 4)))
                batch = [frames[index] for index in chosen]
                answers = predictor.predict_batch(batch, stamps=chosen)
                answers.append(predictor.predict(*batch[0], stamp=chosen[0]))
                for answer in answers:
                    assert_same(answer, expected[answer.stamp])
            return 12

        with ThreadPoolExecutor(8) as pool:
            assert list(pool.map(work, range(8))) == [12] * 8


def test_closing_lets_a_call_that_is_under_way_end(model_file, make_frame, change_run):
    predictor = Predictor(model_file())
    rgb, depth = make_frame()
    expected = predictor.predict(rgb, depth)
    running, go_on = threading.Event(), threading.Event()

    def wait(run, feed):
        running.set()
        assert go_on.wait(60)
        return run()

    change_run(wait)
    with ThreadPoolExecutor(1) as pool:
        call = pool.submit(predictor.predict, rgb, depth)
        assert running.wait(60)
        predictor.close()
        go_on.set()
        np.testing.assert_array_equal(call.result(60).depth, expected.depth)
