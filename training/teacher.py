"""The teacher of a training: a trained network whose answers are learned."""

from models import Network
from runtime.errors import InputError
from training.initial_weights import Weights
from training.losses import LossConfig


def prepare_teacher(weights: Weights | None, loss: LossConfig, network: Network) -> Network | None:
    """Return the teacher of ``network``; None if the loss compares with no teacher.

    Args:
        weights: its checkpoint; None = none was given.
        loss: the options of the loss, of which some need a teacher.
        network: the network that is trained.

    Returns:
        The teacher, without gradients and with its batch statistics frozen.

    Raises:
        InputError: if a loss needs a teacher that was not given, or the other way round; or for a
            teacher whose answers mean something else: other classes, another range or camera.
    """
    heads = loss.taught_heads(network.heads)
    if weights is None:
        if not heads:
            return None
        raise InputError(
            f"loss.distilled_{heads[0]}_weight compares answers with a teacher's. Give --teacher, "
            "for example --teacher ssdnet-lite, or set it to 0."
        )
    given = f"--teacher {weights.path.name}"
    if not heads:
        raise InputError(
            f"{given}: no weight loss.distilled_..._weight above 0 applies to the "
            f"heads of {network.config.name!r} ({', '.join(network.heads)}), so that nothing would "
            "be learned from it. Set one, or leave --teacher out."
        )
    teacher = weights.network
    if missing := [head for head in heads if head not in teacher.heads]:
        raise InputError(
            f"{given}: has no head {missing[0]!r}. Set "
            f"loss.distilled_{missing[0]}_weight = 0, or give a teacher with it."
        )
    for key in ("classes", "max_depth_m", "canonical_focal_px"):
        wanted, found = (_meaning(item, key) for item in (network, teacher))
        if wanted != found:
            raise InputError(
                f"{given}: its {key} is {found}, that of the recipe {wanted}. Give a "
                "teacher that was trained for the same, or change model.config."
            )
    return teacher.eval().requires_grad_(False)


def _meaning(network: Network, key: str) -> object:
    """Return a setting of a network that its answers depend on; of classes the names."""
    value = getattr(network.config, key)
    return [info.name for info in value] if key == "classes" else value
