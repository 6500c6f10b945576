"""The end of `ssdnet-finetune`: the bundled classes joined against one's own, and what is kept."""

import re

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from layouts.pictures import write
from models import CAMVID_CLASSES, SSDNetLite, load_checkpoint, save_checkpoint
from training.commands.finetune import app
from training.fine_tuning.own_folders import cut
from training.scores.scoring import torch_predict

NAMES = [info.name for info in CAMVID_CLASSES]
NOTHING = np.zeros((48, 64), np.float32)


@pytest.fixture
def mine(tmp_path, tiny_lite):
    """Pictures whose labels are the answers of the weights, in two classes that join CamVid's."""
    torch.manual_seed(0)
    network = SSDNetLite(tiny_lite).eval()
    save_checkpoint(tmp_path / "first.pt", network, training={"trained_height": 48})
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(12)]
    answers = [torch_predict(network)(image, NOTHING, None).semantic for image in images]
    often = np.bincount(np.ravel(answers)).argmax()
    for number, (image, answer) in enumerate(zip(images, answers, strict=True)):
        write(tmp_path / f"images/{number:02}.png", image)
        write(tmp_path / f"labels/{number:02}.png", (answer == often).astype(np.uint8))
    others = ", ".join(name for name in NAMES if name != NAMES[often])
    (tmp_path / "classes.txt").write_text(f"others = {others}\noften = {NAMES[often]}\n")
    return tmp_path


def finetune(folder, *further, steps=2):
    options = ("labels", "classes.txt", "first.pt", "run")
    keys = ("--labels", "--classes", "--init", "--out")
    given = [text for key, name in zip(keys, options, strict=True) for text in (key, folder / name)]
    fixed = ("--set", f"schedule.steps = {steps}", "--set", "data.workers = 0")
    arguments = [folder / "images", *given, *fixed, *further]
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_a_model_that_became_worse_is_not_kept(mine):
    command = ("--set", "optimizer.learning_rate = 1.0", "--set", "loop.ema_decay = 0.0")
    for _ in range(2):  # the same command tells the same again
        result = finetune(mine, *command)
        assert result.exit_code == 0, result.output
        expected = r"2 classes on 6 frames kept apart: first, joined: 100\.0; yours: .*: worse\n"
        assert re.search(expected, result.stdout)
        assert "kept: the model before; the trained one is" in result.stdout
        *_, path, score, export, run = result.stdout.splitlines()
        assert path == f"{mine}/run/model.pt"
        assert score == (
            f"ssdnet-eval {mine}/first.pt {mine}/run --images TEST/images --labels TEST/labels "
            f"--classes {mine}/classes.txt"
        )
        assert export == f"ssdnet-export {path} {mine}/run/model.onnx"
        assert run == f"ssdnet-run {mine}/images --model {mine}/run/model.onnx"
    kept, trained = (load_checkpoint(mine / "run" / name) for name in ("model.pt", "trained.pt"))
    assert kept.model.config.class_rows == (10, 1)
    assert (kept.facts.step, trained.facts.step) == (0, 2)
    assert trained.facts.recipe["loop"]["ema_keeps_start"]
    image = cv2.imread(str(mine / "images/03.png"))[..., ::-1].copy()
    answer = torch_predict(kept.model)(image, NOTHING, None).semantic
    assert np.array_equal(answer, cv2.imread(str(mine / "labels/03.png"), cv2.IMREAD_UNCHANGED))


def test_folds_score_every_frame_and_the_last_training_has_all(mine):
    (mine / "classes.txt").write_text("other\noften\nnever\n")  # known from the labels alone
    result = finetune(mine, "--folds", "3")
    assert result.exit_code == 0, result.output
    assert "mIoU of 2 classes on 12 frames kept apart: first, joined: 100.0; " in result.stdout
    assert "as first.pt answers its pixels; a line other = ... of --classes names" in result.stderr
    assert "begin at random: never; " in result.stderr
    assert "kept: the model before" not in result.stdout
    assert "the last training, on all frames, has no score of its own\n" in result.stdout
    facts = load_checkpoint(mine / "run/model.pt").facts
    assert facts.recipe["data"]["source"][0]["parts"] == ((0, 11),)
    assert facts.recipe["validation"]["source"] == ()
    assert not facts.recipe["loop"]["ema_keeps_start"]  # of which a random class would suffer
    fold = load_checkpoint(mine / "run/fold-2/model.pt").facts.recipe
    assert fold["data"]["source"][0]["parts"] == ((0, 3), (8, 11))
    assert fold["validation"]["source"][0]["parts"] == ((4, 7),)
    assert fold["schedule"]["steps"] == 2


def test_frames_are_cut_where_a_place_ends():
    names = [f"a{n}" for n in range(5)] + [f"b{n}" for n in range(9)] + ["b100", "b101"]
    assert [len(block) for block in cut(names, 3)] == [5, 6, 5]
    assert [len(block) for block in cut(names, 2)] == [5, 11]
    assert [block[0] for block in cut(names, 8)] == [0, 2, 5, 6, 8, 10, 12, 14]
