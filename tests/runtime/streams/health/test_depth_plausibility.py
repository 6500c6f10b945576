import numpy as np
import pytest

from runtime import Predictor
from runtime.contract.degraded import IMAGE_CONSTANT, NO_DEPTH
from runtime.engine.prediction import Latency, Prediction
from runtime.recordings.bundled_stream import bundled_frames
from runtime.streams.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility, Implausible

SIZE = (96, 160)
FAR = "far where the depth predicted from the image is near"
MIRRORED = "flipped left to right"


def scene(seed=0):
    """A road that ends in houses, nearer on the left than on the right, float32 metres."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] / 1.0
    houses = 6 + 30 * column / SIZE[1] + 4 * np.random.default_rng(seed).random(SIZE)
    return np.minimum(houses, 150 / (row + 1)).astype(np.float32)


def camera_only(depth, **changes):
    options = {"latency": Latency(0, 0, 0, 0), "degraded": (NO_DEPTH,), **changes}
    return Prediction({"depth": depth}, SIZE, SIZE, **options)


def returns(depth):
    sparse = np.zeros_like(depth)
    sparse[::3, ::2] = depth[::3, ::2]
    return sparse


def find(sparse, seen=None, **changes):
    check = DepthPlausibility()
    check.add(camera_only(scene(1) if seen is None else seen, **changes), sparse)
    return check.finding()


@pytest.mark.parametrize("factor", [0.4, 0.8, 1.0, 1.5, 1.7])
def test_right_returns_are_plausible_also_where_the_focal_length_is_not_known(factor):
    assert find(returns(scene() * np.float32(factor))) is None


@pytest.mark.parametrize("factor", [1e-3, 0.1, 256 / 1000, 2.3, 1000 / 256, 1000])
def test_a_wrong_unit_is_found_with_its_factor(factor):
    found = find(returns(scene() * np.float32(factor)))
    assert found.ratio == pytest.approx(factor, rel=0.05)
    assert "times as far as the depth predicted from the image" in found.cause


@pytest.mark.parametrize("mark", [np.finfo(np.float32).max, np.inf, np.nan, -1])
def test_marks_of_no_return_hide_nothing(mark):
    sparse = returns(scene() * np.float32(10))
    found = find(np.where(sparse > 0, sparse, np.float32(mark)))
    assert found.ratio == pytest.approx(10, rel=0.05)


@pytest.mark.parametrize("unit", [1, 384])
def test_inverse_depth_is_found(unit):
    found = find(returns(unit / scene()))
    assert FAR in found.cause
    assert found.ratio is None


@pytest.mark.parametrize("factor", [0.1, 1, 10])
def test_a_mirrored_map_is_found_in_any_unit(factor):
    found = find(returns(scene()[:, ::-1] * np.float32(factor)))
    assert MIRRORED in found.cause
    assert found.ratio is None


def test_what_the_camera_cannot_see_is_no_reason():
    """A model guesses a road of any scale in the dark: near below, far above."""
    road = np.broadcast_to(150 / (np.arange(SIZE[0])[:, None] + 1), SIZE).astype(np.float32)
    wrong = returns(scene() * 10)
    assert find(wrong) is not None
    assert find(wrong, seen=road) is None
    assert find(wrong, seen=np.full(SIZE, 5, np.float32)) is None
    assert find(wrong, valid=False) is None
    assert find(wrong, degraded=(NO_DEPTH, IMAGE_CONSTANT)) is None
    few = np.zeros_like(wrong)
    few[::9, ::10] = wrong[::9, ::10]
    assert find(few) is None
    assert find(np.full(SIZE, np.nan, np.float32)) is None


def test_the_median_of_the_last_frames_counts():
    check = DepthPlausibility()
    seen, right, wrong = camera_only(scene(1)), returns(scene()), returns(scene() * 10)
    assert check.finding() is None
    for sparse in (right, right, wrong):
        check.add(seen, sparse)
    assert check.finding() is None
    for sparse in (wrong, wrong):
        check.add(seen, sparse)
    assert check.finding().ratio == pytest.approx(10, rel=0.05)
    for _ in range(FIRST_FRAMES):  # an early alarm is cleared
        check.add(seen, right)
    assert check.finding() is None
    for _ in range(3):  # a unit that changes later is found
        check.add(seen, wrong)
    assert check.finding().ratio == pytest.approx(10, rel=0.05)


@pytest.mark.parametrize(("ratio", "depth_scale", "focal_px", "advised"), [
    (3.9, 256, None, ["depth_scale=1000"]), (0.1, 256, None, ["depth_scale of about 26"]),
    (1e6, None, None, ["unit"]), (4, None, 300, ["unit", "300 px", "about 1200"]),
    (4, 256, 180.5, ["depth_scale=1000", "180.5 px", "about 720"]),
])  # fmt: skip
def test_the_advice_names_what_was_given(ratio, depth_scale, focal_px, advised):
    text = Implausible("the cause", ratio).advice(depth_scale=depth_scale, focal_length_px=focal_px)
    assert text.startswith("the cause: ")
    assert all(each in text for each in advised)
    assert ("px" in text) == (focal_px is not None)
    assert Implausible("mirrored").advice(depth_scale=256, focal_length_px=300) == "mirrored"


def test_a_bundled_model_on_a_frame_of_the_bundled_stream():
    frame = bundled_frames()[0]
    depth = frame.sparse_depth
    with Predictor("ssdnet-nano", threads=1, warmup=0) as predictor:
        answer = predictor.predict(frame.rgb, None)

    def found(sparse):
        check = DepthPlausibility()
        check.add(answer, np.ascontiguousarray(sparse))
        return check.finding()

    assert found(depth) is None
    for factor in (0.1, 1000 / 256, 10):
        assert 0.5 < found(depth * np.float32(factor)).ratio / factor < 1.5
    assert MIRRORED in found(depth[:, ::-1]).cause
    assert FAR in found(np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)).cause


NOWHERE = "fit the image nowhere"


def street(turn=0.0):
    """A street that ends 60 m ahead, its houses nearer at the sides; `turn` of its width aside."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] / 1.0
    houses = 6 / np.maximum(np.abs((column / SIZE[1] - 0.5 + turn) * 2), 0.1)
    return np.minimum(houses, 600 / (row + 1)).astype(np.float32)


def shuffled(sparse, seed=0):
    where = sparse > 0
    mixed = np.zeros_like(sparse)
    mixed[where] = np.random.default_rng(seed).permutation(sparse[where])
    return mixed


@pytest.mark.parametrize("wrong", [
    shuffled, lambda sparse: np.rint(sparse * 256).astype(np.uint16).byteswap() / np.float32(256),
])  # fmt: skip
def test_returns_that_fit_the_image_nowhere_are_found(wrong):
    found = find(wrong(returns(street())), seen=street())
    assert NOWHERE in found.cause
    assert found.ratio is None
    row = 600 / (np.mgrid[: SIZE[0], : SIZE[1]][0] + 1)
    night = np.minimum(row, 60).astype(np.float32)  # what a model guesses that sees nothing
    assert find(wrong(returns(street())), seen=night) is None


def test_returns_of_another_view_are_like_the_image_only_by_near_below():
    """They correlate as a whole: said after three frames, not of one."""
    check, other = DepthPlausibility(), street(turn=0.25)
    for frame in range(3):
        assert check.finding() is None, frame
        check.add(camera_only(street()), returns(other))
    assert NOWHERE in check.finding().cause
