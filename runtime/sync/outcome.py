"""The possible outcomes of a message of a sensor."""

from enum import StrEnum


class Sensor(StrEnum):
    """Where a message comes from."""

    IMAGE = "image"
    DEPTH = "depth"
    POSE = "pose"


#: The sensors whose messages are matched with each other.
MATCHED = (Sensor.IMAGE, Sensor.DEPTH)


class Outcome(StrEnum):
    """What happened to a message."""

    ANSWERED = "answered"
    # Dropped:
    OVERTAKEN = "overtaken"  # live: a newer frame was complete before its turn
    INCOMPLETE = "incomplete"  # live: an image without depth gave way to a complete frame
    UNREAD = "unread"  # live: its result was not fetched before the next one was there
    OVERFLOW = "overflow"  # live: more messages than can wait
    DUPLICATE = "duplicate"  # a stamp that this sensor has sent before
    LATE = "late"  # older than an image that was already decided
    CLOSED = "closed"  # pushed after the stream was closed
    # Unmatched:
    NO_IMAGE = "no_image"  # depth: no image within max_skew_ms
    REUSED = "reused"  # depth: only used by an image without depth of its own
    CLOCK_JUMP = "clock_jump"  # depth: it waited when the stamps jumped back
    # Errors:
    BAD_STAMP = "bad_stamp"
    BAD_MESSAGE = "bad_message"  # an array of a wrong shape or dtype, or with invalid values
    INPUT_ERROR = "input_error"  # image and depth do not fit each other, or the model
    INFERENCE_ERROR = "inference_error"


UNMATCHED = frozenset({Outcome.NO_IMAGE, Outcome.REUSED, Outcome.CLOCK_JUMP})
ERRORS = frozenset(
    {Outcome.BAD_STAMP, Outcome.BAD_MESSAGE, Outcome.INPUT_ERROR, Outcome.INFERENCE_ERROR}
)
DROPPED = frozenset(Outcome) - UNMATCHED - ERRORS - {Outcome.ANSWERED}
