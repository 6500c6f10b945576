"""The loop learns, resumes to the same weights, and stops when it must."""

import json
import multiprocessing
import re
import shutil
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from layouts.virtual_kitti import write_second_edition
from models import (
    SSDNet,
    SSDNetLite,
    SSDNetLiteConfig,
    create_model,
    load_checkpoint,
    save_checkpoint,
)
from models.registry import NETWORKS, Entry
from runtime.errors import CheckpointError, DatasetError, InputError, OutputError
from training.datasets.camvid import CamVidRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.initial_weights import read_weights
from training.loading.augment import AugmentConfig
from training.loop import train
from training.losses import LossConfig
from training.recipe import (
    DataRecipe,
    LoopRecipe,
    ModelRecipe,
    OptimizerRecipe,
    Recipe,
    ReleaseRecipe,
    ScheduleRecipe,
    ValidationRecipe,
)
from training.run_folder import lock_folder
from training.state import NonFiniteLossError

TINY = SSDNetLiteConfig(
    encoder_widths=(8,) * 16,
    decoder_channels=(16, 16, 16),
)


# The joint terms favour one class everywhere until the semantics stand on their own feet.
INDEPENDENT = LossConfig(semantic_boundary_weight=0.0, semantic_depth_weight=0.0)


@pytest.fixture(autouse=True)
def tiny_model(monkeypatch):
    monkeypatch.setitem(NETWORKS, "ssdnet-lite", Entry(SSDNetLite, TINY))


@pytest.fixture
def data(tmp_path):
    """CamVid's layout with frames whose upper half is sky (blue) and lower half road (grey)."""
    rng = np.random.default_rng(0)
    for split in ("train", "val"):
        for folder in (split, f"{split}annot"):
            (tmp_path / "data" / "camvid" / folder).mkdir(parents=True)
        for index in range(6):
            horizon = int(rng.integers(20, 40))
            image = np.full((64, 80, 3), 90, np.uint8)
            image[:horizon] = (230, 160, 60)  # BGR
            image = (image + rng.integers(0, 20, image.shape)).astype(np.uint8)
            label = np.full((64, 80), 3, np.uint8)
            label[:horizon] = 0
            root = tmp_path / "data" / "camvid"
            cv2.imwrite(str(root / split / f"{index}.png"), image)
            cv2.imwrite(str(root / f"{split}annot" / f"{index}.png"), label)
    return tmp_path / "data"


def recipe(steps=6, *, checkpoint_every=1000, **loop_options):
    source = CamVidRecipe(path="camvid")
    return Recipe(
        model=ModelRecipe("ssdnet-lite"),
        data=DataRecipe(
            (source,),
            augment=AugmentConfig(crop=(32, 48), scale=(0.9, 1.2)),
            batch_size=4,
            workers=0,
        ),
        schedule=ScheduleRecipe(steps=steps, warmup_steps=min(2, steps)),
        loop=LoopRecipe(
            ema_decay=0.5, checkpoint_every=checkpoint_every, log_every=1, **loop_options
        ),
        validation=ValidationRecipe(),
    )


def validated(run, every=1000, **options):
    """The recipe with a validation on CamVid."""
    source = (CamVidRecipe(path="camvid", split="val"),)
    return replace(run, validation=ValidationRecipe(every=every, source=source, **options))


def weights(path: Path):
    return load_checkpoint(path).model.state_dict()


def right_share(path, data):
    """Share of the pixels of a picture whose class a checkpoint finds."""
    image = cv2.imread(str(data / "camvid/val/0.png"))[..., ::-1].copy()
    label = cv2.imread(str(data / "camvid/valannot/0.png"), -1)
    rgb = torch.from_numpy(image).permute(2, 0, 1)[None].float()
    with torch.no_grad():
        output = load_checkpoint(path).model(rgb, torch.zeros(1, 1, 64, 80))
    return (output.semantic_logits.argmax(1)[0].numpy() == label).mean()


#: Its statistics follow 30 steps; those of the lite encoder, which begins pretrained, do not.
QUICK = ModelRecipe(
    "ssdnet-small",
    config={
        "stem_channels": [8, 8],
        "encoder_channels": [16, 16],
        "encoder_blocks": [1, 1],
        "decoder_channels": [16, 16],
    },
)


def test_two_views_are_trained_to_agree_and_resume_to_the_same_weights(data, tmp_path):
    source = replace(recipe().data.source[0])
    run = replace(
        recipe(steps=3),
        data=DataRecipe(
            (source,),
            augment=AugmentConfig(crop=(96, 96), scale=(1.6, 2.0), blur=0, noise=0, pair_shift=16),
            batch_size=2,
            workers=0,
        ),
        loss=LossConfig(depth_consistency_weight=2.0, semantic_consistency_weight=0.5),
    )
    whole = weights(train(run, data=[data], out=tmp_path / "whole"))
    train(run, data=[data], out=tmp_path / "parts", stop_after=2)
    parts = weights(train(run, data=[data], out=tmp_path / "parts"))
    assert all(torch.equal(value, whole[name]) for name, value in parts.items())


def test_a_shift_smaller_than_the_cells_of_the_classes_is_refused(data, tmp_path):
    run = replace(recipe(steps=1), model=ModelRecipe("fast-scnn"))
    augment = AugmentConfig(crop=(96, 96), pair_shift=4)
    run = replace(run, data=replace(run.data, augment=augment))
    with pytest.raises(InputError, match=r"pair_shift = 4; .*'fast-scnn' are on cells of 8 px"):
        train(run, data=[data], out=tmp_path / "run")


def test_interrupted_run_ends_at_the_same_weights(data, tmp_path):
    """Those of the network and those that the loss learned."""
    run = replace(recipe(steps=3), loss=LossConfig(weighting="uncertainty"))
    expected = weights(train(run, data=[data], out=tmp_path / "whole"))
    for stop in (1, 2):
        train(run, data=[data], out=tmp_path / "parts", stop_after=stop)
    parts = weights(train(run, data=[data], out=tmp_path / "parts"))
    assert all(torch.equal(value, expected[name]) for name, value in parts.items())
    whole, parts = (
        load_checkpoint(tmp_path / name / "last.pt").trainer["criterion"]
        for name in ("whole", "parts")
    )
    assert whole["log_variances.semantic"] != 0
    assert whole["log_variances.depth"] == 0  # CamVid has no depth
    assert all(torch.equal(parts[name], value) for name, value in whole.items())


def test_parts_that_are_not_trained_stay_as_they_are(data, tmp_path):
    """Weights and batch statistics, through a validation, too; the others move."""
    init = tmp_path / "init.pt"
    save_checkpoint(init, create_model("ssdnet-lite"))
    run = replace(recipe(steps=2), optimizer=OptimizerRecipe(only=("semantic_",)))
    run = validated(run, every=1)
    before = weights(init)
    after = weights(train(run, data=[data], out=tmp_path / "run", init=read_weights(init)))
    moved = {name.split(".")[0] for name in after if not torch.equal(after[name], before[name])}
    assert moved == {
        "semantic_decoder",
        "semantic_refine",
        "semantic_head",
        "semantic_coarse_head",
    }


def test_tensorboard_shows_terms_rates_scores_and_pictures(data, tmp_path):
    run = validated(recipe(steps=1, accumulate=2))
    train(run, data=[data], out=tmp_path / "run")
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"), {"images": 0, "scalars": 0})
    events.Reload()
    scalars = events.Tags()["scalars"]
    assert {"loss/semantic", "loss/boundary", "loss/total", "learning_rate"} <= set(scalars)
    assert "validation/camvid/miou" in scalars
    pictures = events.Tags()["images"]
    assert pictures == ["camvid/camvid/0", "camvid/camvid/5"]
    png = np.frombuffer(events.Images(pictures[0])[0].encoded_image_string, np.uint8)
    picture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    image = cv2.imread(str(data / "camvid/val/0.png"))
    # Image, classes, depth, its uncertainty, boundary of the prediction; image and classes of the
    # truth. Titles stand at the top.
    assert picture.shape[1] == 7 * 80
    assert (picture[40:64, :80] == image[40:64]).all()
    assert (picture[40:64, 400:480] == image[40:64]).all()
    assert not (picture[40:64, 480:] == image[40:64]).all()


def test_validation_feeds_the_lidar_of_the_recipe(data, tmp_path):
    write_second_edition(data / "scenes", magnify=8)
    errors = []
    for lidar in ("none", "random:0.5", "random:0.5"):
        run = replace(
            recipe(steps=1),
            validation=ValidationRecipe(source=(RenderedRecipe(path="scenes"),), lidar=lidar),
        )
        out = tmp_path / f"run{len(errors)}"
        train(run, data=[data], out=out)
        events = EventAccumulator(str(out / "tensorboard"))
        events.Reload()
        errors.append(events.Scalars("validation/scenes/mae_m")[0].value)
    assert errors[1] == errors[2]
    assert errors[0] != errors[1]


def test_best_weights_and_scores_survive_an_interruption(data, tmp_path):
    run = replace(recipe(steps=3), release=ReleaseRecipe(logit_adjustment=0.5))
    run = validated(run, every=1, best="camvid/boundary_f")
    train(run, data=[data], out=tmp_path / "whole")
    train(run, data=[data], out=tmp_path / "parts", stop_after=2)
    left = (tmp_path / "parts" / "last.pt").read_bytes()
    train(run, data=[data], out=tmp_path / "parts")
    # Killed after the last validation, before its checkpoint: it is done again.
    (tmp_path / "parts" / "last.pt").write_bytes(left)
    (tmp_path / "parts" / "model.pt").unlink()
    train(run, data=[data], out=tmp_path / "parts")
    best, expected = (load_checkpoint(tmp_path / name / "best.pt") for name in ("parts", "whole"))
    assert best.training["step"] == expected.training["step"]
    whole, parts = ((tmp_path / name / "scores.csv").read_text() for name in ("whole", "parts"))
    assert whole == parts
    header, *rows = whole.splitlines()
    assert [row.split(",")[0] for row in rows] == ["1", "2", "3"]
    assert {"miou", "fwiou", "iou_sky", "boundary_f"} <= set(header.split(","))


def test_a_damaged_state_of_the_loop_is_not_resumed(data, tmp_path):
    last = train(recipe(), data=[data], out=tmp_path / "run", stop_after=1)
    document = torch.load(last, weights_only=True)
    pair = torch.tensor([0, 0])
    odd = {"step": pair, "optimizer": None, "average": {"x": 1}, "criterion": pair}
    for part, value in odd.items():
        trainer = {**document["trainer"], part: value}
        torch.save({**document, "trainer": trainer}, last)
        with pytest.raises(CheckpointError, match="cannot be resumed"):
            train(recipe(), data=[data], out=tmp_path / "run")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"frozen": ("",)}, "nothing would learn: .* optimizer.frozen"),
        ({"only": ("semantic_head",)}, "nothing would learn: .* optimizer.only"),
        ({"only": ("depth_",)}, r"no frame of camvid has a target .* its terms depth.* need depth"),
    ],
)
def test_a_run_in_which_nothing_would_learn_is_refused(data, tmp_path, changes, text):
    depth_alone = LossConfig(1.0, 0.0, 0.0, 0.0, 0.0)
    run = replace(recipe(steps=1), loss=depth_alone, optimizer=OptimizerRecipe(**changes))
    with pytest.raises(InputError, match=text):
        train(run, data=[data], out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_sets_without_a_target_of_the_loss_are_refused(data, tmp_path):
    for path in (data / "camvid" / "trainannot").iterdir():
        cv2.imwrite(str(path), np.full((64, 80), 11, np.uint8))
    for weighting in ("none", "median"):
        run = replace(recipe(steps=1), loss=LossConfig(class_weighting=weighting))
        with pytest.raises(InputError, match=r"no frame of camvid has a target of the loss: its t"):
            train(run, data=[data], out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    # One set that has one is enough.
    write_second_edition(data / "scenes", magnify=8)
    both = replace(run.data, source=(*run.data.source, RenderedRecipe(path="scenes")))
    assert train(replace(run, data=both), data=[data], out=tmp_path / "run").name == "model.pt"


def test_a_damaged_frame_is_named_without_a_traceback(data, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "training.loading.open_dataset.FREQUENCY_SAMPLES", 1
    )  # so that a worker reads it first
    (data / "camvid" / "train" / "3.png").write_bytes(b"nothing")
    run = replace(recipe(), loss=LossConfig(class_weighting="none"))
    run = replace(run, data=replace(run.data, workers=1))
    others = set(multiprocessing.active_children())
    with pytest.raises(DatasetError) as raised:
        train(run, data=[data], out=tmp_path / "run")
    # Though the traceback holds the loader: a worker that is left keeps the process from ending.
    assert set(multiprocessing.active_children()) <= others
    assert len(str(raised.value).splitlines()) == 1
    assert str(raised.value).startswith(str(data / "camvid" / "train" / "3.png"))


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
        train(recipe(steps=1), data=[data], out=tmp_path / "run")
    other.kill()
    other.join()
    assert train(recipe(steps=1), data=[data], out=tmp_path / "run").name == "model.pt"


def test_files_of_others_are_not_replaced(data, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.pt").write_text("mine")
    with pytest.raises(OutputError, match=r"model\.pt does not belong"):
        train(recipe(steps=1), data=[data], out=tmp_path / "run")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["model.pt"]
    assert (tmp_path / "run" / "model.pt").read_text() == "mine"


def test_another_recipe_in_the_same_folder_is_refused(data, tmp_path):
    train(recipe(steps=2), data=[data], out=tmp_path / "run", stop_after=1)
    with pytest.raises(InputError, match="another recipe"):
        train(recipe(steps=3), data=[data], out=tmp_path / "run")
    (tmp_path / "run" / "recipe.json").unlink()
    with pytest.raises(InputError, match=r"last.pt: belongs to a training with another recipe"):
        train(recipe(steps=3), data=[data], out=tmp_path / "run")


def test_non_finite_loss_names_the_frames(data, tmp_path):
    run = replace(recipe(), optimizer=OptimizerRecipe(learning_rate=1e8))
    with pytest.raises(NonFiniteLossError, match=r"step \d: the loss .*non_finite\.json") as raised:
        train(run, data=[data], out=tmp_path / "run")
    assert ".pt" not in str(raised.value)  # weights that began at random may all have diverged
    document = json.loads((tmp_path / "run" / "non_finite.json").read_text())
    assert len(document["frames"]) == recipe().data.batch_size
    assert all(name.startswith("camvid/") for name in document["frames"])
    assert "semantic" in document["terms"]


def test_the_advice_for_a_diverged_run_begins_with_weights_that_have_not(data, tmp_path):
    torch.manual_seed(0)
    save_checkpoint(tmp_path / "first.pt", SSDNetLite(TINY))
    begun = {"init": read_weights(tmp_path / "first.pt"), "data": [data]}
    run = validated(recipe(checkpoint_every=1))
    diverging = replace(run, optimizer=OptimizerRecipe(learning_rate=1e8))
    with pytest.raises(NonFiniteLossError, match=r"--init \S*best\.pt") as raised:
        train(diverging, out=tmp_path / "run", **begun)
    best = Path(re.search(r"--init (\S+)", str(raised.value))[1])
    assert max(float(value.abs().max()) for value in weights(best).values()) < 1e3
    begun["init"] = read_weights(best)
    assert train(run, out=tmp_path / "again", **begun).name == "model.pt"


def test_accumulated_batches_make_the_step_of_their_mean_gradient(data, tmp_path):
    """Two batches of 1 against one of 2, for a layer behind which no normalisation sees a batch."""
    sgd = OptimizerRecipe("sgd", 0.01, weight_decay=0.0, momentum=0.0, only=("semantic_head",))
    # The cross-entropy of frames that are labelled everywhere: a mean of means is the mean.
    run = replace(
        recipe(steps=1, accumulate=2),
        optimizer=sgd,
        loss=LossConfig(0.0, 1.0, 0.0, 0.0, 0.0, class_weighting="none"),
    )
    whole_frames = replace(run.data.augment, scale=(1.0, 1.0))
    apart = replace(run, data=replace(run.data, augment=whole_frames, batch_size=1))
    together = replace(
        run,
        data=replace(apart.data, batch_size=2),
        loop=replace(run.loop, accumulate=1),
    )
    train(apart, data=[data], out=tmp_path / "a")
    train(together, data=[data], out=tmp_path / "b")
    a, b = (weights(tmp_path / name / "last.pt") for name in ("a", "b"))
    torch.manual_seed(run.data.seed)
    start = create_model("ssdnet-lite").state_dict()
    assert not torch.equal(a["semantic_head.bias"], start["semantic_head.bias"])
    for name, value in a.items():
        torch.testing.assert_close(value, b[name], rtol=1e-4, atol=1e-7)


def test_a_network_learns_sky_from_road_and_another_its_answers(data, tmp_path):
    rate = OptimizerRecipe(learning_rate=6e-3)
    labelled = replace(recipe(steps=30), model=QUICK, loss=INDEPENDENT, optimizer=rate)
    teacher = train(labelled, data=[data], out=tmp_path / "teacher")
    assert right_share(teacher, data) > 0.9
    other = tmp_path / "other.pt"
    save_checkpoint(other, create_model("ssdnet-small", **QUICK.config))
    # Nothing but the teacher's answers: without labels no other term has a target.
    for path in data.glob("camvid/trainannot/*.png"):
        cv2.imwrite(str(path), np.full((64, 80), 11, np.uint8))
    taught = LossConfig(class_weighting="none", distilled_semantic_weight=1.0)
    run = replace(labelled, loss=taught, data=replace(labelled.data, seed=5))
    student = train(run, data=[data], out=tmp_path / "student", teacher=read_weights(teacher))
    assert load_checkpoint(student).training["teacher"].startswith("model.pt (sha256 ")
    assert right_share(student, data) > 0.9
    with pytest.raises(InputError, match=r"--teacher"):
        train(run, data=[data], out=tmp_path / "alone")
    with pytest.raises(InputError, match=r"teacher was 'model.pt"):
        train(run, data=[data], out=tmp_path / "student", teacher=read_weights(other))


def test_init_of_which_nothing_fits_is_refused(data, tmp_path):
    plain = replace(
        NETWORKS["ssdnet"].config,
        encoder_channels=(8,) * 5,
        encoder_blocks=(1,) * 5,
        decoder_channels=(8,) * 5,
        boundary_channels=3,
    )
    other = tmp_path / "other.pt"
    save_checkpoint(other, SSDNet(plain))
    with pytest.raises(CheckpointError, match="none of its layers fits"):
        train(recipe(steps=1), data=[data], out=tmp_path / "b", init=read_weights(other))
    assert not (tmp_path / "b").exists()


def test_other_data_than_at_the_start_are_named(data, tmp_path, capsys):
    train(recipe(steps=3), data=[data], out=tmp_path / "run", stop_after=1)
    moved = data.rename(tmp_path / "moved")
    train(recipe(steps=3), data=[moved], out=tmp_path / "run", stop_after=2)
    assert "warning: camvid" not in capsys.readouterr().err
    for folder in ("train", "trainannot"):
        (moved / "camvid" / folder / "5.png").rename(moved / "camvid" / folder / "7.png")
    for text in ("the 24 files have other names than when", "24 files when the run began, now 22"):
        train(recipe(steps=3), data=[moved], out=tmp_path / "run", stop_after=2)
        assert f"warning: camvid: {text}" in capsys.readouterr().err
        for folder in ("train", "trainannot"):
            (moved / "camvid" / folder / "7.png").unlink(missing_ok=True)


def test_a_full_disk_during_a_validation_is_one_error(data, tmp_path, mount_disk, capfd):
    """The pictures of the validation do not fit; nothing but the error is said."""
    disk = mount_disk(16_384)
    run = validated(recipe(), every=3)
    train(run, data=[data], out=disk / "run", stop_after=2)
    before = (disk / "run" / "last.pt").read_bytes()
    filler = disk / "filler"
    filler.write_bytes(bytes(shutil.disk_usage(disk).free - 12_000))
    with pytest.raises(InputError, match=r"tensorboard.* No space left.* run the command"):
        train(run, data=[data], out=disk / "run")
    assert "Traceback" not in capfd.readouterr().err
    assert (disk / "run" / "last.pt").read_bytes() == before
    filler.unlink()
    ended = weights(train(run, data=[data], out=disk / "run"))
    whole = weights(train(run, data=[data], out=tmp_path / "other"))
    assert all(torch.equal(whole[name], ended[name]) for name in whole)


def test_a_full_disk_leaves_the_last_good_checkpoint(data, tmp_path, mount_disk):
    run = recipe(steps=2, checkpoint_every=1)
    whole = weights(train(run, data=[data], out=tmp_path / "whole"))
    disk = mount_disk(16_384)
    train(run, data=[data], out=disk / "run", stop_after=1)
    filler = disk / "filler"
    filler.write_bytes(bytes(shutil.disk_usage(disk).free - 40_000))
    with pytest.raises(CheckpointError, match=r"could not be written.*Free some space"):
        train(run, data=[data], out=disk / "run")
    kept = load_checkpoint(disk / "run" / "last.pt")
    assert kept.trainer["step"] == 1
    left = {path.name for path in (disk / "run").iterdir()}
    assert left == {".ssdnet", "last.pt", "recipe.json", "tensorboard"}
    filler.unlink()
    ended = weights(train(run, data=[data], out=disk / "run"))
    assert all(torch.equal(ended[name], value) for name, value in whole.items())


def test_final_checkpoint_is_adjusted_and_the_resumable_one_is_not(data, tmp_path):
    plain = replace(recipe(steps=1), loss=replace(INDEPENDENT, class_weighting="median"))
    adjusted = replace(plain, release=ReleaseRecipe(logit_adjustment=1.0))
    a = train(plain, data=[data], out=tmp_path / "a")
    b = train(adjusted, data=[data], out=tmp_path / "b")
    bias = "semantic_head.bias"
    assert torch.equal(weights(a.parent / "last.pt")[bias], weights(b.parent / "last.pt")[bias])
    assert not torch.equal(weights(a)[bias], weights(b)[bias])


@pytest.mark.parametrize(
    ("changes", "device", "text"),
    [
        ({"optimizer": OptimizerRecipe(only=("foo",))}, "cpu", "begins with 'foo'"),
        ({}, "nowhere", "unknown device 'nowhere'"),
    ],
)
def test_what_cannot_start_leaves_no_folder(data, tmp_path, changes, device, text):
    with pytest.raises(InputError, match=text):
        train(replace(recipe(), **changes), data=[data], out=tmp_path / "run", device=device)
    assert not (tmp_path / "run").exists()
