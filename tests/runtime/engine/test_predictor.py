"""The predictor on models whose right answers can be worked out by hand."""

import dataclasses
import hashlib
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from onnxruntime import InferenceSession

from runtime import ContractError, InferenceError, InputError, Predictor

DEPTH_OFFSET_M = 1.5  # of the models by hand


def assert_right(prediction, rgb, depth):
    """The answers of the model by hand, see conftest.make_model."""
    assert np.array_equal(prediction.semantic, (rgb[..., 0] >= 128).astype(np.uint8))
    assert np.array_equal(prediction.depth, depth + np.float32(DEPTH_OFFSET_M))
    expected = rgb[..., 1].astype(np.float32) / rgb[..., 2]
    np.testing.assert_allclose(prediction.boundary, expected, rtol=1e-6)


def test_answers_are_right_at_any_size(model_file, make_frame):
    with Predictor(model_file()) as predictor:
        for size in [(48, 64), (33, 35), (125, 414)]:
            rgb, depth = make_frame(*size)
            prediction = predictor.predict(rgb, depth, stamp=("camera", 17))
            assert_right(prediction, rgb, depth)
            assert (prediction.valid, prediction.degraded) == (True, ())
            assert (prediction.frame_size, prediction.stamp) == (size, ("camera", 17))
            assert prediction.depth_returns == np.count_nonzero(depth)
            assert prediction.cleaned.total == 0
            dtypes = [values.dtype for values in prediction.heads.values()]
            assert dtypes == [np.uint8, np.float32, np.float32]


def test_what_the_predictor_tells_about_itself(model_file, contract):
    path = model_file(size=(48, 64))
    predictor = Predictor(path, threads=1, warmup=2)
    assert dataclasses.replace(predictor.contract, content=contract.content) == contract
    assert predictor.model.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert predictor.size == predictor.model.size == (48, 64)
    assert predictor.heads == ("semantic", "depth", "boundary")
    assert predictor.providers == ("CPUExecutionProvider",)
    assert predictor.node_counts["CPUExecutionProvider"] > 5
    assert predictor.threads == 1
    assert predictor.load_ms > 0
    assert predictor.first_inference_ms > 0
    assert Predictor(path, warmup=0).first_inference_ms is None
    assert Predictor(model_file("free.onnx")).model.size is None


def test_two_frames_in_a_row_do_not_mix(model_file, make_frame):
    with Predictor(model_file()) as predictor:
        first_frame, second_frame = make_frame(seed=1), make_frame(seed=2)
        first, second = predictor.predict(*first_frame), predictor.predict(*second_frame)
        assert_right(first, *first_frame)
        for values in (first.semantic, first.depth, first.boundary):
            values[:] = 9  # the arrays are the caller's: writable, and nobody else's
        assert_right(second, *second_frame)
        assert_right(predictor.predict(*first_frame), *first_frame)


def test_no_depth_map_is_the_camera_alone(model_file, make_frame):
    rgb, _ = make_frame()
    with Predictor(model_file()) as predictor:
        prediction = predictor.predict(rgb)
    assert_right(prediction, rgb, np.zeros(rgb.shape[:2], np.float32))
    assert prediction.degraded == ("no_depth",)


def test_the_uncertainty_comes_where_the_model_has_it(model_file, make_frame):
    rgb, depth = make_frame()
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    with Predictor(model_file(heads=heads)) as predictor:
        assert predictor.heads == heads
        prediction = predictor.predict(rgb, depth)
    assert_right(prediction, rgb, depth)
    assert prediction.depth_uncertainty.dtype == np.float32
    assert np.array_equal(prediction.depth_uncertainty, prediction.depth / 16)
    for size in [(33, 101), (144, 40)]:  # smaller and larger: of the same pixel as its depth
        resized = Predictor(model_file("fixed.onnx", heads=heads, size=size)).predict(rgb, depth)
        assert resized.depth_uncertainty.shape == (48, 64)
        assert np.array_equal(resized.depth_uncertainty, resized.depth / 16)


@pytest.mark.parametrize(("size", "trained", "frame", "runs_at"), [
    (None, 40, (80, 96), (40, 48)),
    (None, 40, (50, 60), (50, 60)),
    (None, None, (80, 96), (80, 96)),
    ("frame", 40, (80, 96), (80, 96)),
    (64, 40, (80, 100), (64, 80)),
    (96, None, (48, 64), (96, 128)),
    ((33, 70), None, (48, 64), (33, 70)),
])  # fmt: skip
def test_a_model_of_free_size_runs_at_the_size_asked_for(
    model_file, make_frame, contract, size, trained, frame, runs_at
):
    """The graph fails at any other size; the warm-up runs at it, too."""
    path = model_file(
        only_runs_at=runs_at,
        contract=dataclasses.replace(contract, trained_height=trained, native_size=frame),
        heads=("semantic", "depth", "boundary", "semantic_logits"),
    )
    with Predictor(path, size=size) as predictor:
        prediction = predictor.predict(*make_frame(*frame))
        assert predictor.size == size
        assert predictor.model.size is None
        assert predictor.network_size(frame) == runs_at
    assert prediction.network_size == runs_at
    assert prediction.frame_size == frame
    for answer in (prediction.semantic, prediction.depth, prediction.boundary):
        assert answer.shape == frame
    assert prediction.semantic_logits.shape == (2, *frame)


@pytest.mark.parametrize("size", [None, (40, 40)])
def test_nan_and_inf_in_an_answer_are_never_passed_on_silently(model_file, make_frame, size):
    rgb, depth = make_frame()
    predictor = Predictor(model_file(size=size))
    for green in (0, 5):  # 0 / 0 is NaN, 5 / 0 is Inf
        rgb[10:20, 10:20] = (0, green, 0)
        prediction = predictor.predict(rgb, depth)
        assert not prediction.valid
        assert prediction.degraded == ("boundary_not_finite",)
    rgb[:], depth[:] = 0, 0
    reasons = predictor.predict(rgb, depth).degraded
    assert reasons == ("no_depth", "image_constant", "boundary_not_finite")


def test_after_an_error_the_predictor_is_as_good_as_new(model_file, make_frame):
    rgb, depth = make_frame()
    with Predictor(model_file(only_runs_at=(48, 64))) as predictor:
        for bad, error, said in (
            ((rgb.astype(np.float32), depth), InputError, "rgb"),
            ((rgb, depth[:-1]), InputError, "sparse_depth"),
            ((None, None), InputError, "rgb"),
            (make_frame(50, 70), InferenceError, "50 x 70"),
        ):
            with pytest.raises(error, match=said):
                predictor.predict(*bad)
            assert_right(predictor.predict(rgb, depth), rgb, depth)


def test_a_closed_predictor_says_so(model_file, make_frame):
    with Predictor(model_file()) as predictor:
        predictor.predict(*make_frame())
    for call in (lambda: predictor.predict(*make_frame()), predictor.reset):
        with pytest.raises(InferenceError, match="closed"):
            call()
    predictor.close()  # twice does no harm


@pytest.mark.parametrize(("name", "value"), [("threads", 0), ("warmup", -1), ("device_id", -1)])
def test_arguments_out_of_range_are_refused(model_file, name, value):
    with pytest.raises(InputError, match=name):
        Predictor(model_file(), **{name: value})


@pytest.mark.parametrize("size", [(-1, 40), 5, (40, 10**6)])
def test_warm_up_refuses_an_invalid_size(model_file, size):
    with pytest.raises(InputError, match="must be"):
        Predictor(model_file()).warm_up(size)


FORKED = """
import os, sys, numpy as np
from runtime import InferenceError, Predictor, PushStream
rgb, depth = np.full((48, 64, 3), 7, np.uint8), np.zeros((48, 64), np.float32)
predictor = Predictor(sys.argv[1], threads=2)
stream = PushStream(predictor)
calls = {
    "predict": lambda: predictor.predict(rgb),
    "reset": predictor.reset,
    "push": lambda: stream.push_image(rgb, 1.0),
    "next": lambda: next(stream),
    "close": stream.close,
}
child = os.fork()
if not child:
    refused = 0
    for call in calls.values():
        try:
            call()
        except InferenceError as error:
            refused += "in each process" in str(error)
    predictor.close()
    os._exit(refused)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == len(calls)
stream.push_image(rgb, 1.0)
stream.close()
assert [result.prediction.valid for result in stream] == [True]
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_after_a_fork_every_call_is_an_error_and_the_parent_goes_on(model_file):
    """A child has no worker and none of the session's threads: frames would wait for ever."""
    program = [sys.executable, "-W", "ignore", "-c", FORKED, model_file()]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_predictor_that_is_pickled_names_what_to_do(model_file):
    with pytest.raises(InputError, match="each process"):
        pickle.dumps(Predictor(model_file(), warmup=0))


def test_a_prediction_names_its_classes_and_is_short(model_file, make_frame):
    prediction = Predictor(model_file()).predict(make_frame()[0])
    assert prediction.class_names == ("dark", "red")
    shown = repr(prediction)
    assert shown.startswith("Prediction(semantic, depth, boundary; ")
    assert shown.endswith(" ms; valid, no_depth)")
    assert dataclasses.replace(prediction, contract=None).class_names == ()


def test_reset_recovers_from_a_provider_that_failed(model_file, make_frame, monkeypatch):
    frame, run, lost = make_frame(), InferenceSession.run, []

    def run_or_fail(session, *given):
        lost[:] = lost or [session]
        if session is lost[0]:
            raise RuntimeError("CUDA error 999")
        return run(session, *given)

    with Predictor(model_file(), threads=1) as predictor:
        expected = predictor.predict(*frame)
        monkeypatch.setattr(InferenceSession, "run", run_or_fail)
        for _ in range(2):
            with pytest.raises(InferenceError, match="CUDA error 999"):
                predictor.predict(*frame)
        predictor.reset()
        np.testing.assert_array_equal(predictor.predict(*frame).depth, expected.depth)


def test_reset_runs_no_other_model_than_before(model_file, make_frame):
    frame = make_frame()
    with Predictor(model_file(), threads=1) as predictor:
        model_file(heads=("depth",))  # in the same place
        with pytest.raises(ContractError):
            predictor.reset()
        assert predictor.predict(*frame).semantic is not None, "the old session stays"
