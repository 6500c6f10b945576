"""Which teacher a training takes, and what it says to one that it cannot learn from."""

import pytest

from models import create_model, save_checkpoint
from runtime.errors import InputError
from training.initial_weights import prepare_teacher, read_weights
from training.losses import LossConfig

TAUGHT = LossConfig(distilled_semantic_weight=1.0, distilled_depth_weight=1.0)


@pytest.fixture(scope="module")
def student():
    return create_model("ssdnet-nano")


def teacher_weights(folder, **changes):
    path = folder / "teacher.pt"
    save_checkpoint(path, create_model("ssdnet-nano", **changes))
    return read_weights(path)


def test_it_answers_as_it_was_released_and_does_not_learn(student, tmp_path):
    teacher = prepare_teacher(teacher_weights(tmp_path), TAUGHT, student)
    assert not teacher.training
    assert not any(parameter.requires_grad for parameter in teacher.parameters())


def test_losses_without_a_teacher_and_a_teacher_without_losses_are_refused(student, tmp_path):
    with pytest.raises(InputError, match=r"distilled_semantic_weight .* --teacher ssdnet-lite"):
        prepare_teacher(None, TAUGHT, student)
    with pytest.raises(InputError, match="nothing would be learned"):
        prepare_teacher(teacher_weights(tmp_path), LossConfig(), student)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"classes": create_model("ssdnet-nano").config.classes[::-1]}, "its classes is"),
        ({"max_depth_m": 80.0}, "its max_depth_m is 80.0"),
        ({"canonical_focal_px": 500.0}, "its canonical_focal_px is 500.0, that of the recipe"),
        ({"depth_head": False}, "has no head 'depth'"),
    ],
)
def test_a_teacher_whose_answers_mean_something_else_is_refused(student, tmp_path, changes, text):
    with pytest.raises(InputError, match=text):
        prepare_teacher(teacher_weights(tmp_path, **changes), TAUGHT, student)
