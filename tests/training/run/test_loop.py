"""The loop learns, resumes to the same weights, and stops when it must."""

import json
import multiprocessing
import os
import shutil
import signal
import time
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from layouts.virtual_kitti import write_second_edition
from models import create_model, load_checkpoint
from runtime.base.errors import CheckpointError, DatasetError, InputError, OutputError
from training.datasets.camvid import CamVidRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.evaluate import evaluate
from training.loading.augment_config import AugmentConfig
from training.loading.data_recipe import DataRecipe
from training.loading.open_dataset import CheckedSource, open_dataset
from training.losses import LossConfig
from training.losses.terms import TERMS
from training.run import loop, validation
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe, derive
from training.run.run_folder import lock_folder
from training.run.state import NonFiniteLossError
from training.run.training_run import TrainingRun
from training.run.validation_recipe import ValidationRecipe
from training.weights.initial_weights import read_weights
from training.weights.release import ReleaseRecipe

pytestmark = pytest.mark.usefixtures("tiny_lite")

# The joint terms favour one class everywhere until the semantics stand on their own feet.
INDEPENDENT = LossConfig(weights={"semantic_boundary": 0.0, "semantic_depth": 0.0})


def recipe(steps=6, **tables):
    """Return the recipe of a short training; `tables` are those of `derive`."""
    run = Recipe(
        model=ModelRecipe("ssdnet-lite"),
        data=DataRecipe(
            (CamVidRecipe(path="camvid"),),
            augment=AugmentConfig(crop=(32, 48), scale=(0.9, 1.2)),
            batch_size=4,
            workers=0,
        ),
        schedule=ScheduleRecipe(steps=steps, warmup_steps=min(2, steps)),
        loop=LoopRecipe(ema_decay=0.5, checkpoint_every=1000, log_every=1),
    )
    return derive(run, **tables)


def validated(run, **options):
    """The recipe with a validation on CamVid."""
    source = (CamVidRecipe(path="camvid", split="val"),)
    return replace(run, validation=ValidationRecipe(source=source, **options))


def train(run, data, out, **options):
    """Train, and return the path of the checkpoint."""
    return loop.train(run, TrainingRun([data], out, **options)).path


def weights(path):
    return load_checkpoint(path).model.state_dict()


def assert_equal(first, second):
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name


def read_events(run):
    events = EventAccumulator(str(run / "tensorboard"), {"images": 0, "scalars": 0})
    events.Reload()
    return events


def test_an_interrupted_run_ends_at_the_same_weights_and_scores(data, tmp_path):
    """Weights of the network and of the loss, with two views of each frame; best, last, average."""
    augment = {"crop": (96, 96), "scale": (1.6, 2.0), "pair_shift": 16}
    loss = LossConfig(weighting="uncertainty", weights={"semantic_consistency": 0.5})
    run = recipe(3, data={"batch_size": 2, "augment": augment}, loss=loss)
    run = validated(run, every=1, best="camvid/boundary_f")
    expected = weights(train(run, data, tmp_path / "whole"))
    last = tmp_path / "parts/last.pt"
    for stop in (1, 2):
        found = loop.train(run, TrainingRun([data], tmp_path / "parts", stop_after=stop))
        assert (found.path, found.stopped, str(found)) == (last, True, str(last))
    left = last.read_bytes()
    assert not loop.train(run, TrainingRun([data], tmp_path / "parts")).stopped
    # Killed after the last validation, before its checkpoint: it is done again.
    last.write_bytes(left)
    (tmp_path / "parts" / "model.pt").unlink()
    assert_equal(weights(train(run, data, tmp_path / "parts")), expected)
    best, expected = (load_checkpoint(tmp_path / name / "best.pt") for name in ("parts", "whole"))
    assert best.training["step"] == expected.training["step"]
    whole, parts = ((tmp_path / name / "scores.csv").read_text() for name in ("whole", "parts"))
    assert whole == parts
    header, *rows = whole.splitlines()
    assert [row.split(",")[0] for row in rows] == ["1", "2", "3"]
    assert {"miou", "fwiou", "iou_sky", "boundary_f"} <= set(header.split(","))
    whole, parts = (
        load_checkpoint(tmp_path / name / "last.pt").trainer["criterion"]
        for name in ("whole", "parts")
    )
    assert whole["log_variances.semantic"] != 0
    assert whole["log_variances.depth"] == 0  # CamVid has no depth
    assert_equal(parts, whole)


def test_tensorboard_shows_terms_rates_scores_and_pictures(data, tmp_path):
    run = validated(recipe(1, loop={"accumulate": 2}))
    train(run, data, tmp_path / "run")
    events = read_events(tmp_path / "run")
    scalars = events.Tags()["scalars"]
    assert {"loss/semantic", "loss/boundary", "loss/total", "learning_rate"} <= set(scalars)
    assert "validation/camvid/miou" in scalars
    pictures = events.Tags()["images"]
    assert pictures == ["camvid/camvid/0", "camvid/camvid/5"]
    png = np.frombuffer(events.Images(pictures[0])[0].encoded_image_string, np.uint8)
    picture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    image = cv2.imread(str(data / "camvid/val/0.png"))
    # The overlay of the prediction, and beside it that of the truth, whose classes are below its
    # image. Titles stand at the top of each panel.
    assert (picture[40:64, :80] == image[40:64]).all()
    truth = picture[:, 360:440]
    assert (truth[40:64] == image[40:64]).all()
    assert not (truth[104:128] == image[40:64]).all()


def test_validation_feeds_the_lidar_of_the_recipe(data, tmp_path, monkeypatch, capsys):
    write_second_edition(data / "scenes", magnify=8)
    score_set = Mock(wraps=validation.score_set)
    monkeypatch.setattr(validation, "score_set", score_set)
    errors = []
    for number, lidar in enumerate(("none", "random:0.5")):
        scored = ValidationRecipe(source=(RenderedRecipe(path="scenes"),), lidar=lidar)
        out = tmp_path / str(number)
        train(recipe(1, validation=scored), data, out)
        errors.append(read_events(out).Scalars("validation/scenes/mae_m")[0].value)
    assert errors[0] != errors[1]
    assert score_set.call_count == 2  # the page takes the scores of the validation
    page = (out / "validation.html").read_text()
    assert "scenes, LiDAR random:0.5" in page
    assert "Worst depth of after" in page
    assert f"tensorboard --logdir {out}" in capsys.readouterr().err
    (row,) = evaluate([out]).rows  # of the run's folder: its set, with its input
    assert row.model == out.name
    assert (row.data, row.lidar) == ("scenes", "random:0.5")
    assert row.figures["mae_m"] == pytest.approx(errors[1], rel=1e-5)


def test_a_damaged_state_of_the_loop_is_not_resumed(data, tmp_path):
    last = train(recipe(), data, tmp_path / "run", stop_after=1)
    document = torch.load(last, weights_only=True)
    for part in ("step", "average"):
        torch.save({**document, "trainer": {**document["trainer"], part: None}}, last)
        with pytest.raises(CheckpointError, match="cannot be resumed"):
            train(recipe(), data, tmp_path / "run")


def test_a_damaged_frame_is_named_without_a_traceback(data, tmp_path, monkeypatch):
    # So that a worker reads it first.
    monkeypatch.setattr("training.loading.open_dataset.FREQUENCY_SAMPLES", 1)
    (data / "camvid" / "train" / "3.png").write_bytes(b"nothing")
    run = recipe(loss={"class_weighting": "none"}, data={"workers": 1})
    others = set(multiprocessing.active_children())
    with pytest.raises(DatasetError) as raised:
        train(run, data, tmp_path / "run")
    # Though the traceback holds the loader: a worker that is left keeps the process from ending.
    assert set(multiprocessing.active_children()) <= others
    assert len(str(raised.value).splitlines()) == 1
    assert str(raised.value).startswith(str(data / "camvid" / "train" / "3.png"))


class InWorker:
    """Frames of which a worker process reads none."""

    def __init__(self, source, fail):
        self.source, self.images, self.fail = source, source.images, fail

    def __len__(self):
        return len(self.source)

    def __getitem__(self, index):
        if multiprocessing.parent_process() is not None:
            self.fail()
        return self.source[index]


@pytest.mark.parametrize(("fail", "text"), [
    (lambda: os.kill(os.getpid(), signal.SIGKILL), r"has ended .*resumes by the same command"),
    (lambda: 1 / 0, r"the reader of frame \d+ failed with ZeroDivisionError: .*test_loop.py, line"),
])  # fmt: skip
def test_what_fails_in_a_worker_ends_the_run_in_a_line(data, tmp_path, monkeypatch, fail, text):
    opened = open_dataset
    monkeypatch.setattr(
        "training.run.task.open_dataset",
        lambda item, **options: CheckedSource(InWorker(opened(item, **options), fail), item),
    )
    with pytest.raises(InputError, match=text) as raised:
        train(recipe(data={"workers": 1}), data, tmp_path / "run")
    assert len(str(raised.value).splitlines()) == 1


def test_a_worker_that_is_killed_while_it_sends_is_named(data, tmp_path, monkeypatch):
    def lost(_):
        raise ConnectionResetError(104, "Connection reset by peer")
        yield

    monkeypatch.setattr("training.run.batches.DataLoader.__iter__", lost)
    with pytest.raises(InputError, match=r"has ended .*lost a worker: .*reset by peer"):
        train(recipe(data={"workers": 1}), data, tmp_path / "run")


def test_batches_that_shared_memory_cannot_hold_are_read_without_workers(
    data, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("training.run.batches.shutil.disk_usage", lambda _: SimpleNamespace(free=9))
    train(recipe(data={"workers": 1}), data, tmp_path / "run")
    assert "the training reads its data itself" in capsys.readouterr().err
    assert_equal(weights(tmp_path / "run/model.pt"), weights(train(recipe(), data, tmp_path / "b")))


def test_a_folder_has_one_writer(data, tmp_path):
    """The lock of a process that was killed is gone with it, though its file is there."""
    held = multiprocessing.get_context("fork").Event()

    def hold():
        with lock_folder(tmp_path / "run"):
            held.set()
            time.sleep(60)

    other = multiprocessing.get_context("fork").Process(target=hold)
    other.start()
    assert held.wait(20)
    with pytest.raises(InputError, match="another process trains in it"):
        train(recipe(1), data, tmp_path / "run")
    other.kill()
    other.join()
    assert train(recipe(1), data, tmp_path / "run").name == "model.pt"


def test_files_of_others_are_not_replaced(data, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.pt").write_text("mine")
    with pytest.raises(OutputError, match=r"model\.pt does not belong"):
        train(recipe(1), data, tmp_path / "run")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["model.pt"]


def test_non_finite_loss_names_the_frames(data, tmp_path):
    run = recipe(optimizer={"learning_rate": 1e8})
    with pytest.raises(NonFiniteLossError, match=r"step \d: .*non_finite\.json"):
        train(run, data, tmp_path / "run")
    document = json.loads((tmp_path / "run" / "non_finite.json").read_text())
    assert len(document["frames"]) == run.data.batch_size
    assert all(name.startswith("camvid/") for name in document["frames"])
    assert "semantic" in document["terms"]


def test_accumulated_batches_make_the_step_of_their_mean_gradient(data, tmp_path):
    """Two batches of 1 against one of 2, for a layer behind which no normalisation sees a batch."""
    sgd = OptimizerRecipe("sgd", 0.01, weight_decay=0.0, momentum=0.0, only=("semantic_head",))
    # The cross-entropy of frames that are labelled everywhere: a mean of means is the mean.
    loss = LossConfig(
        weights={**dict.fromkeys(TERMS, 0.0), "semantic": 1.0}, class_weighting="none"
    )
    found = []
    for size, batches in ((1, 2), (2, 1)):
        changes = {"batch_size": size, "augment": {"scale": (1.0, 1.0)}}
        run = recipe(1, loop={"accumulate": batches}, optimizer=sgd, loss=loss, data=changes)
        train(run, data, tmp_path / str(size))
        found.append(weights(tmp_path / str(size) / "last.pt"))
    torch.manual_seed(run.data.seed)
    start = create_model("ssdnet-lite").state_dict()
    assert not torch.equal(found[0]["semantic_head.bias"], start["semantic_head.bias"])
    for name, value in found[0].items():
        torch.testing.assert_close(value, found[1][name], rtol=1e-4, atol=1e-7)


def right_share(path, data):
    """Share of the pixels of a picture whose class a checkpoint finds."""
    image = cv2.imread(str(data / "camvid/val/0.png"))[..., ::-1].copy()
    label = cv2.imread(str(data / "camvid/valannot/0.png"), -1)
    rgb = torch.from_numpy(image).permute(2, 0, 1)[None].float()
    with torch.no_grad():
        output = load_checkpoint(path).model(rgb, torch.zeros(1, 1, 64, 80))
    return (output.semantic_logits.argmax(1)[0].numpy() == label).mean()


# Its statistics follow 30 steps; those of the lite encoder, which begins pretrained, do not.
QUICK = ModelRecipe(
    "ssdnet-small",
    config={
        "stem_channels": [8, 8],
        "encoder_channels": [16, 16],
        "encoder_blocks": [1, 1],
        "decoder_channels": [16, 16],
    },
)


def test_a_network_learns_sky_from_road_and_another_its_answers(data, tmp_path):
    labelled = recipe(30, model=QUICK, loss=INDEPENDENT, optimizer={"learning_rate": 6e-3})
    teacher = train(labelled, data, tmp_path / "teacher")
    assert right_share(teacher, data) > 0.9
    # Nothing but the teacher's answers: without labels no other term has a target.
    for path in data.glob("camvid/trainannot/*.png"):
        cv2.imwrite(str(path), np.full((64, 80), 11, np.uint8))
    taught = LossConfig(class_weighting="none", weights={"distilled_semantic": 1.0})
    run = derive(labelled, loss=taught, data={"seed": 5})
    student = train(run, data, tmp_path / "student", teacher=read_weights(teacher))
    assert load_checkpoint(student).training["teacher"].startswith("model.pt (sha256 ")
    assert right_share(student, data) > 0.9


def test_a_full_disk_leaves_the_last_good_checkpoint(data, tmp_path, mount_disk):
    run = recipe(2, loop={"checkpoint_every": 1})
    disk = mount_disk(16_384)
    train(run, data, disk / "run", stop_after=1)
    filler = disk / "filler"
    filler.write_bytes(bytes(shutil.disk_usage(disk).free - 40_000))
    with pytest.raises(CheckpointError, match=r"could not be written.*free some space"):
        train(run, data, disk / "run")
    assert load_checkpoint(disk / "run" / "last.pt").trainer["step"] == 1
    left = {path.name for path in (disk / "run").iterdir()}
    assert left == {".ssdnet", "last.pt", "recipe.json", "tensorboard"}
    filler.unlink()
    assert train(run, data, disk / "run").name == "model.pt"


def test_final_checkpoint_is_adjusted_and_the_resumable_one_is_not(data, tmp_path):
    """Without an average the two checkpoints differ in nothing else."""
    release = ReleaseRecipe(logit_adjustment=1.0)
    run = recipe(1, loss=INDEPENDENT, release=release, loop={"ema_decay": 0.0})
    path = train(run, data, tmp_path / "run")
    final, last = weights(path), weights(path.with_name("last.pt"))
    changed = {name for name, value in final.items() if not torch.equal(value, last[name])}
    assert changed == {"semantic_head.bias"}


def test_what_cannot_start_leaves_no_folder(data, tmp_path):
    for change, device in (({"optimizer": {"only": ("foo",)}}, "cpu"), ({}, "nowhere")):
        with pytest.raises(InputError, match=r"'foo'|'nowhere'"):
            train(recipe(**change), data, tmp_path / "run", device=device)
    assert not (tmp_path / "run").exists()
