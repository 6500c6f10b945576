"""What every source of frames is: a list of its frames, and a way to read each of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from runtime.io.calibration import Calibration
from runtime.sources.frames import Frame


@dataclass(frozen=True)
class ListedFrame:
    """A frame that a source has, not read yet.

    sequence: its place in the source, from 0 on
    name: of the frame and of its answers' files; no other frame of the source has it
    image, depth: where the source finds them, its own matter; None = there is none
    image_stamp_ns, depth_stamp_ns: when the sensors took them [ns]; None = not known
    complete: whether it has all that a frame of this source should have
    """

    sequence: int
    name: str
    image: Any
    depth: Any
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    complete: bool = True


class Source(ABC):
    """A stream of frames that can be listed and read again.

    It is made of a path and of options by keyword; what cannot be one raises InputError then, or
    when it is listed. One thread at a time reads. `calibration` is None where it is not known.
    """

    #: Names of its options, each a keyword of its constructor.
    options: ClassVar[tuple[str, ...]] = ()

    calibration: Calibration | None = None
    #: Folders that frames are read from: no answers may be written there.
    folders: tuple[Path, ...] = ()
    #: Recordings, files or whole folders: no output may take their place or a file's in them.
    recordings: tuple[Path, ...] = ()

    @abstractmethod
    def __init__(self, path: Path, **options: Any) -> None:
        """Open what lies at `path`. Raises InputError."""

    @abstractmethod
    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """List the frames in their order; with `limit` up to that many complete ones.

        Raises InputError.
        """

    @abstractmethod
    def read(self, frame: ListedFrame) -> Frame:
        """Read a frame of the list; frames in the list's order are the quickest.

        Raises InputError if it is damaged or misses what it needs; others can still be read.
        """

    @property
    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Say in the words of report.json what is read, and, once listed, what was left out."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines for people: what was guessed, and, once listed, what was left out."""
        return ()

    def close(self) -> None:  # noqa: B027 - most hold nothing open
        """Let go of open files. May be called again."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def up_to(frames: Iterable[ListedFrame], limit: int | None) -> tuple[ListedFrame, ...]:
    """List frames up to the `limit`-th complete one."""
    listed: list[ListedFrame] = []
    complete = 0
    for frame in frames:
        listed.append(frame)
        complete += frame.complete
        if complete == limit:
            break
    return tuple(listed)


_Key = TypeVar("_Key")


def pair_up(
    keys: Iterable[_Key],
    images: Mapping[_Key, Any],
    depths: Mapping[_Key, Any] | None,
    *,
    limit: int | None,
    name: Callable[[_Key], str] = str,
) -> tuple[ListedFrame, ...]:
    """List a frame for each key; complete are those with both files, `depths` None = with one."""
    frames = (
        ListedFrame(
            sequence,
            name(key),
            images.get(key),
            (depths or {}).get(key),
            complete=key in images and (depths is None or key in depths),
        )
        for sequence, key in enumerate(keys)
    )
    return up_to(frames, limit)


def no_depth(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The depth map of a frame that has none: float32 (H, W) of zeros."""
    return np.zeros(rgb.shape[:2], np.float32)
