"""The names of everything that a recording can be found to be, for lists and --accept."""

from collections.abc import Iterable

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.checks.judge import NO_EVIDENCE, NO_RETURNS, NOWHERE
from runtime.checks.poses import OTHER_POSES, POSES
from runtime.checks.readings import READINGS

LENS_ENDS, NO_MATCH = "lens_ends", "no_match"
# Each finding with its meaning; {} stands for what fits best.
FINDINGS: dict[str, str] = {
    **{each.name: each.says for each in READINGS},
    **{name: f"the poses are to be {each.says}" for name, each in POSES.items()},
    OTHER_POSES: "scans that the poses move are far apart",
    NOWHERE: "the returns fit the image in no reading",
    NO_RETURNS: "no return is in the image",
    NO_MATCH: "no image matches the time of a scan or depth map",
    NO_EVIDENCE: "the images are too dark, blurred or noisy to judge by them",
    LENS_ENDS: "the lens of the calibration ends inside the images",
}


def check_accepted(names: Iterable[str]) -> frozenset[str]:
    """Return names of `FINDINGS` as a set. Raises InputError for another one."""
    accepted = frozenset(names)
    if unknown := sorted(accepted - FINDINGS.keys()):
        raise InputError(
            f"accept takes names of findings, got {shown(unknown[0])}: ssdnet-doctor --readings "
            "lists them"
        )
    return accepted
