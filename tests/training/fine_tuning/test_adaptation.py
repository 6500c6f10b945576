"""The depth adapted to a recording: its frames, what is trained, and what is kept."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from models import SSDNetLite, SSDNetLiteConfig, create_model, load_checkpoint, save_checkpoint
from runtime.base.errors import InputError
from runtime.recordings.bundled_stream import bundled_frames
from runtime.recordings.listing import ListedFrame
from training.base.stop_signal import never
from training.commands.adapt import app
from training.fine_tuning import adaptation as adapting
from training.fine_tuning.adaptation import FEEDS, adapt, make_recipe, split_fed
from training.fine_tuning.adaptation_frames import (
    LEAST_FRAMES,
    LEAST_RETURNS,
    MOST_FRAMES,
    choose_frames,
    describe_recording,
    find_frames,
)
from training.loading.lidar_input import draw_lidar
from training.loading.open_dataset import open_dataset
from training.run.training_run import TrainingRun
from training.scores.scoring import HeadMaps
from training.weights.initial_weights import read_weights

SIZE, FOCAL_PX = (96, 160), 120.0
STEPS = ["schedule.steps = 1", "schedule.warmup_steps = 0", "data.augment.crop = [64, 96]"]
CALIBRATION = f"""
intrinsics = [[{FOCAL_PX}, 0, 80], [0, {FOCAL_PX}, 48], [0, 0, 1]]
extrinsics = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


@pytest.fixture
def rig(tmp_path):
    """Twelve frames of a tilted plane: a folder of images and one of depth."""
    rng = np.random.default_rng(0)
    rows = np.arange(SIZE[0])[:, None]
    plane = 100 / (2 + 0.1 * rows + np.zeros(SIZE))
    for folder in ("images", "lidar"):
        (tmp_path / "rig" / folder).mkdir(parents=True)
    for number in range(12):
        depth = np.where(rng.random(SIZE) < 0.05, plane * (1 + 0.02 * number), 0)
        picture = rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "rig" / "images" / f"{number}.png"), picture)
        cv2.imwrite(
            str(tmp_path / "rig" / "lidar" / f"{number}.png"), (256 * depth).astype(np.uint16)
        )
    return tmp_path / "rig"


def described(rig):
    return describe_recording(str(rig / "images"), depth=rig / "lidar")


def start(rig, init, out, changes=STEPS, **options):
    recording, root = described(rig)
    return adapt(recording, init, TrainingRun([root], out, **options), changes)


@pytest.fixture(autouse=True)
def small_bundled_frames(monkeypatch):
    """Let the bundled recording be a part of its first two frames, which is quickly predicted."""
    frames = [
        SimpleNamespace(rgb=frame.rgb[:64, :96], sparse_depth=frame.sparse_depth[:64, :96])
        for frame in bundled_frames()[:2]
    ]
    monkeypatch.setattr(adapting, "bundled_frames", lambda: frames)


@pytest.fixture
def weights(tmp_path):
    """A small network whose depth is not the base."""
    torch.manual_seed(0)
    config = SSDNetLiteConfig(
        encoder_widths=(16,) * 16, decoder_channels=(16, 16, 16), geometry_channels=8
    )
    network = SSDNetLite(config)
    torch.nn.init.normal_(network.surface_depth.head.weight)
    path = tmp_path / "small.pt"
    save_checkpoint(path, network, training={"data": ["made"], "trained_height": 96})
    return path


def test_only_layers_of_the_depth_alone_are_trained(rig, weights, tmp_path):
    init = read_weights(weights)
    found = start(rig, init, tmp_path / "out")
    trained = load_checkpoint(tmp_path / "out" / "training" / "model.pt").model
    before, after = init.network.state_dict(), trained.state_dict()
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed
    assert {name.split(".")[0] for name in changed} <= {"depth_decoder", "surface_depth"}
    assert not any(name.startswith("surface_depth.embed") for name in changed)
    rgb, sparse = torch.rand(1, 3, *SIZE) * 255, torch.zeros(1, 1, *SIZE)
    sparse[..., ::12, ::3], sparse[..., 6::12, ::3] = 12.0, 30.0
    with torch.no_grad():
        one, other = init.network.eval()(rgb, sparse), trained.eval()(rgb, sparse)
    assert torch.equal(one.semantic_logits, other.semantic_logits)
    assert torch.equal(one.boundary_logits, other.boundary_logits)
    assert not torch.equal(one.depths[0], other.depths[0])
    assert found.path == tmp_path / "out" / "model.pt"
    # The same call does not train again.
    assert start(rig, init, tmp_path / "out").lines == found.lines


def test_a_change_is_relative_to_the_depth_before(monkeypatch):
    depths = {"before": np.float32([[10, 20]]), "after": np.float32([[11, 19]])}
    asked = []
    monkeypatch.setattr(adapting, "torch_predict", lambda name: asked.append(name) or (
        lambda *frame: HeadMaps(depth=depths[name])
    ))  # fmt: skip
    changes = adapting.bundled_changes("before", {"a": "after", "b": "before"})
    assert changes == {"a": pytest.approx((0.1 + 0.05) / 2), "b": 0}
    assert asked == ["before", "after", "before"]


def test_keys_of_a_named_kind_are_kept_as_values(rig):
    recording, root = describe_recording(
        f"folders:{rig}/images,depth_scale=128,scan_stamp=end", depth=rig / "lidar"
    )
    assert recording.source == "folders"
    assert recording.keys == {"depth_scale": 128, "scan_stamp": "end"}
    with recording.open_source(root / recording.path) as source:
        assert (source.depth_scale, source.inputs["scan_stamp"]) == (128, "end")


@pytest.fixture
def scored(monkeypatch):
    """Give a function that sets the errors that `score` finds, and what is forgotten."""

    def set_scores(errors, forgotten=(0.0, 0.0)):
        errors = iter((9.0, *errors))  # the first are of "linear"

        def score(predict, samples, stop):
            assert len(samples) == 2  # of twelve, in the last tenth of the time
            return dict.fromkeys(FEEDS, np.full(3, next(errors)))

        monkeypatch.setattr(adapting, "score", score)
        monkeypatch.setattr(
            adapting, "bundled_changes", lambda _, models: dict(zip(models, forgotten, strict=True))
        )

    return set_scores


@pytest.mark.parametrize(("errors", "forgotten", "kept"), [
    ((2.0, 3.0, 4.0), (0.0, 0.0), "before"), ((4.0, 3.0, 2.0), (0.0, 0.0), "after"),
    ((4.0, 3.0, 2.0), (0.02, 0.05), "between"),
])  # fmt: skip
def test_the_better_model_is_kept_unless_it_forgets(
    rig, weights, tmp_path, scored, errors, forgotten, kept
):
    init = read_weights(weights)
    scored(errors, forgotten)
    found = start(rig, init, tmp_path / "out")
    assert found.paid == (kept != "before")
    text = "\n".join(found.lines)
    assert "9000 / 9000, 9000" in text
    assert ("5.0 %, too much to be kept" in text) == (kept == "between")
    gain = {"before": "does not pay", "between": "between, -25.0 %", "after": "after, -50.0 %"}
    assert gain[kept] in found.lines[-1]
    states = [
        load_checkpoint(tmp_path / "out" / name).model.state_dict()
        for name in ("training/model.pt", "model.pt")
    ]
    models = {"before": init.network.state_dict(), "after": states[0]}
    for name, value in models.get(kept, {}).items():
        assert torch.equal(states[1][name], value), name
    data = ("made",) if kept == "before" else ("images", "made")
    assert load_checkpoint(found.path).facts.data == data


def listed(count, step_ns=10**8, **keys):
    return [ListedFrame(i, str(i), i, i, image_stamp_ns=i * step_ns, **keys) for i in range(count)]


def test_frames_have_the_time_of_their_stamps():
    frames = listed(50) + [
        ListedFrame(50 + i, "", 0, 0, image_stamp_ns=5 * 10**9 + i * 10**7) for i in range(100)
    ]
    chosen = choose_frames(frames)
    assert [frame for frame, _ in chosen] == frames
    stamps = [frame.image_stamp_ns / frames[-1].image_stamp_ns for frame in frames]
    np.testing.assert_allclose([time for _, time in chosen], stamps)


@pytest.mark.parametrize("empty", [[10, 11], [0, 1, 2, 3, 4, 5], [11], [1, 3, 5, 7, 9]], ids=str)
def test_frames_kept_apart_are_the_last_with_returns(tmp_path, empty):
    """A LiDAR that was switched off at the end, began late, or dropped out."""
    for index in range(12):
        depth = np.full(SIZE, 0 if index in empty else 2560, np.uint16)
        for folder, values in (("images", np.zeros(SIZE, np.uint8)), ("lidar", depth)):
            (tmp_path / folder).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / folder / f"{index:03}.png"), values)
    asked = (*described(tmp_path), tmp_path / "frames.json")
    found = find_frames(*asked, trained_height=None, stop=never)
    usable = tuple(index for index in range(12) if index not in empty)
    assert found.kept_apart in (usable[-1:], usable[-2:])
    assert found.train + found.kept_apart == usable
    (tmp_path / "images" / "000.png").unlink()  # the choice of an earlier start stays
    assert find_frames(*asked, trained_height=None, stop=never) == found


def test_returns_that_cannot_be_scored_are_refused_before_the_training(
    rig, weights, tmp_path, monkeypatch
):
    monkeypatch.setattr(adapting, "train", lambda *_, **__: pytest.fail("it trains"))
    few = np.zeros(SIZE, np.uint16)
    few[0, : LEAST_RETURNS - 1] = 2560
    for path in sorted((rig / "lidar").iterdir())[2:]:
        cv2.imwrite(str(path), few)
    with pytest.raises(InputError, match="2 frames could be read and have returns"):
        start(rig, read_weights(weights), tmp_path / "out")


def test_a_stop_while_frames_are_read_leaves_nothing(rig, weights, tmp_path):
    found = start(rig, read_weights(weights), tmp_path / "out", stop=lambda: True)
    assert (found.lines, found.paid, list(tmp_path.glob("out/*"))) == ((), False, [])


def test_of_a_long_recording_frames_at_equal_distances_are_taken():
    chosen = choose_frames(listed(5000))
    assert MOST_FRAMES - 2 <= len(chosen) <= MOST_FRAMES
    steps = np.diff([frame.sequence for frame, _ in chosen])
    assert steps.min() >= 8
    assert steps.max() <= 9


@pytest.mark.parametrize("with_scans", [0, LEAST_FRAMES - 1])
def test_a_recording_of_too_few_scans_is_refused(with_scans):
    frames = [ListedFrame(i, "", i, i if i < with_scans else None) for i in range(20)]
    with pytest.raises(InputError, match=f"{with_scans} frames"):
        choose_frames(frames)


def test_scans_without_a_return_in_the_image_are_refused_and_nothing_is_kept(
    rig, weights, tmp_path
):
    for path in (rig / "lidar").iterdir():
        cv2.imwrite(str(path), np.zeros(SIZE, np.uint16))
    with pytest.raises(InputError, match="no frame has returns in the image"):
        start(rig, read_weights(weights), tmp_path / "out")
    assert not list(tmp_path.glob("out/*"))


def test_a_folder_that_cannot_be_resumed_is_refused_before_frames_are_read(rig, weights, tmp_path):
    init, out = read_weights(weights), tmp_path / "out"
    (out / "training").mkdir(parents=True)
    (out / "training" / "recipe.json").write_text("{}")
    with pytest.raises(InputError, match=r"an earlier release began .* another --out"):
        start(rig, init, out)
    (out / "frames.json").write_text('{"train": [0]}')
    with pytest.raises(InputError, match=r"frames.json: cannot be read .*missing key kept_apart"):
        start(rig, init, out)


def test_a_network_without_layers_of_the_depth_alone_is_refused(rig, tmp_path):
    path = tmp_path / "classes.pt"
    save_checkpoint(path, create_model("fast-scnn"))
    with pytest.raises(InputError, match="no layers that the depth alone reads"):
        start(rig, read_weights(path), tmp_path / "out")


def test_what_is_not_fed_is_the_target(rig, weights, tmp_path):
    recording, root = described(rig)
    recipe = make_recipe(read_weights(weights), recording)
    sample = open_dataset(recipe.data.source[0], [root], classes=())[0]
    returns = sample.depth > 0
    for seed in range(8):
        drawn = draw_lidar(sample, recipe.data.augment, np.random.default_rng(seed))
        fed, target = drawn.returns > 0, drawn.depth > 0
        assert 0.02 < fed.sum() / returns.sum() < 0.9
        assert target.any()
        assert not (fed & target).any()
        assert not ((fed | target) & ~returns).any()
    first, second = (
        split_fed(sample, FEEDS["every second line"], number).fed > 0 for number in (0, 1)
    )
    np.testing.assert_array_equal(first ^ second, returns)


def test_the_command_prints_the_scores_and_what_to_run_next(rig, weights, tmp_path, scored):
    scored((4.0, 3.0, 2.0))
    (rig / "camera.toml").write_text(CALIBRATION)
    changes = [part for text in STEPS for part in ("--set", text)]
    arguments = [
        *(str(rig / "images"), "--depth", str(rig / "lidar")),
        *("--calibration", str(rig / "camera.toml"), "--out", str(tmp_path / "a run")),
        *("--init", str(weights), *changes),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    *_, export, run = result.stdout.splitlines()
    model = f"'{tmp_path}/a run/model"
    assert export == f"ssdnet-export {model}.pt' {model}.onnx'"
    assert run == (
        f"ssdnet-run {rig}/images --depth {rig}/lidar --calibration {rig}/camera.toml "
        f"--model {model}.onnx'"
    )
    recipe = json.loads((tmp_path / "a run" / "training" / "recipe.json").read_text())["recipe"]
    assert recipe["data"]["source"][0]["calibration"] == "../camera.toml"


def test_poses_by_odometry_are_no_file(rig, monkeypatch):
    recording, root = describe_recording(
        str(rig / "images"), points=rig / "lidar", poses="odometry"
    )
    asked = []
    monkeypatch.setattr(
        "training.datasets.recording.open_source", lambda *_, **given: asked.append(given)
    )
    recording.open_source(root / recording.path)
    assert asked == [{"points": rig / "images" / ".." / "lidar", "poses": "odometry"}]
    assert not any("odometry" in folder for folder in recording.folders)
