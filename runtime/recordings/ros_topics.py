"""The topics of a bag by content: images, depth, or neither unless an option names them."""

import contextlib
from enum import StrEnum

from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume
from runtime.recordings.images import may_be_depth
from runtime.recordings.listing import left_out_note
from runtime.recordings.ros_bag import RosBag
from runtime.recordings.ros_camera import CAMERA_INFO
from runtime.recordings.ros_messages import DEPTHS, MONO16

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
# Value of depth_topic that selects the camera alone, and of pose_topic if scans are not moved.
NO_TOPIC = "none"


class Role(StrEnum):
    """What the images of a topic show."""

    PICTURE = "picture"
    # Such as infrared; the camera only if there is no other picture.
    OTHER_PICTURE = "other picture"
    DEPTH = "depth"
    MAYBE_DEPTH = "maybe depth"  # used only if depth_topic= names it


def role_of(topic: str, encoding: str) -> Role:
    """Return what the images of a topic show, by its name and their encoding.

    The encoding alone does not decide: the counts of a thermal camera are 16UC1 like depth, and
    mono16 is either an infrared picture or depth.
    """
    is_other = not may_be_depth(topic)
    if encoding not in DEPTHS:
        return Role.OTHER_PICTURE if is_other else Role.PICTURE
    return Role.MAYBE_DEPTH if is_other or encoding == MONO16 else Role.DEPTH


def find_topics(
    bag: RosBag, image_topic: str | None, depth_topic: str | None
) -> tuple[str, str | None]:
    """Return the topics of images and of depth, as requested or guessed.

    Raises:
        InputError: if a requested topic is not of its kind, or if a topic must be chosen.
    """
    by_role = _by_role(bag)
    pictures = bag.of_kind(COMPRESSED_IMAGE)
    pictures = [topic for topic in pictures if not topic.endswith("/compressedDepth")]
    others = [t for t in pictures if role_of(t, "") is Role.OTHER_PICTURE]
    others += by_role[Role.OTHER_PICTURE]
    images = [*pictures, *by_role[Role.PICTURE], *by_role[Role.OTHER_PICTURE]]
    twice = {f"{topic}/compressed" for topic in images}  # compressed copies of the same images
    single = [topic for topic in images if topic not in twice]
    single = [topic for topic in single if topic not in others] or single
    image = choose_topic(bag, "image_topic", image_topic, images, single)
    if image is None:
        ways = "`image_topic=TOPIC`, or TOPIC+TOPIC for several"
        raise _undecided(bag, "images", single, ways)
    if depth_topic == NO_TOPIC:
        return image, None
    depths, named = bag.of_kind(POINT_CLOUD) + by_role[Role.DEPTH], by_role[Role.MAYBE_DEPTH]
    depth = choose_topic(bag, "depth_topic", depth_topic, depths + named, depths)
    if depth is None and (depths or not named):
        ways = f"`depth_topic=TOPIC`, or `depth_topic={NO_TOPIC}` for the camera alone"
        raise _undecided(bag, "point clouds or depth images", depths, ways)
    if depth is None:
        assume(
            f"the camera alone, since {', '.join(named)} may be no depth, by name or encoding",
            f"name it by `depth_topic=`, or state `depth_topic={NO_TOPIC}`",
        )
    return image, depth


def choose_topic(
    bag: RosBag, option: str, requested: str | None, fitting: list[str], guesses: list[str]
) -> str | None:
    """The requested topic, else the only guess, else None. Raises InputError."""
    if requested is None:
        return guesses[0] if len(guesses) == 1 else None
    if requested not in fitting:
        raise InputError(
            f"{option}={requested} is not a topic of its kind in {bag.path}, which has "
            f"{', '.join(fitting) or 'none'}"
        )
    return requested


def infos_beside(bag: RosBag, topic: str) -> list[str]:
    """The topics of CameraInfo in the namespaces of a topic of images, the innermost first."""
    parts, infos = topic.split("/"), bag.of_kind(CAMERA_INFO)
    names = ("/".join([*parts[:end], "camera_info"]) for end in reversed(range(len(parts))))
    return [name for name in names if name in infos]


def _by_role(bag: RosBag) -> dict[Role, list[str]]:
    """The topics of Image messages by their role, which their first message decides."""
    by_role: dict[Role, list[str]] = {role: [] for role in Role}
    for topic in bag.of_kind(IMAGE):
        with contextlib.suppress(InputError):  # no message may be decodable
            by_role[role_of(topic, bag.first(topic).encoding)].append(topic)
    return by_role


def _undecided(bag: RosBag, what: str, topics: list[str], ways: str) -> InputError:
    kinds = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.types.items()))
    return InputError(
        f"{bag.path} has {len(topics) or 'no'} topics of {what}, give {ways}. "
        f"It has the topics {'; '.join([kinds or '(none)', *left_out_note(bag.left_out)])}"
    )
