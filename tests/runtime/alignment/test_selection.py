"""Which frames of a recording are compared."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from painted_street import scan_of, street_frame
from runtime import InputError
from runtime.alignment.selection import choose_frames
from runtime.geometry.poses import PoseTrack
from runtime.recordings.listing import ListedFrame
from runtime.streams.frame import Frame
from runtime.streams.frame_view import compensated_points
from runtime.streams.messages import Depth, Image, Scan


def source_of(frames):
    """A source of these frames; those that are None are damaged."""

    def read(listed):
        if (frame := frames[listed.sequence]) is None:
            raise InputError("damaged")
        return frame

    listed = [ListedFrame(number, str(number), number, number) for number in range(len(frames))]
    return SimpleNamespace(list_frames=lambda: listed, read=read)


def test_frames_with_structure_are_spread_over_the_recording():
    """The first frame of each pair shows an empty road, and the fifth pair has a damaged frame."""
    frames = [street_frame(number, boxes=9 * (number % 2)) for number in range(10)]
    frames[9] = None
    chosen = list(choose_frames(source_of(frames), 5))
    assert [frame.image.stamp_ns // 10**8 for frame, _ in chosen] == [1, 3, 5, 7, 8]
    for frame, beside in chosen[:4]:
        at = frame.image.stamp_ns // 10**8
        assert np.array_equal(beside["the frame before"], frames[at - 1].depth.points)
        assert np.array_equal(beside["the frame after"], frames[at + 1].depth.points)
    assert [*chosen[4][1]] == ["the frame before"]


def test_scans_within_half_a_second_are_beside_a_frame_with_stamps():
    source = source_of([street_frame(number) for number in range(14)])
    listed = source.list_frames()
    source.list_frames = lambda: [
        replace(each, image_stamp_ns=10**9 + number * 10**8) for number, each in enumerate(listed)
    ]
    *_, (frame, beside) = choose_frames(source, 2)
    times = [f"0.{each} s before" for each in (5, 4, 3, 2, 1)]
    after = (13 * 10**8 - frame.image.stamp_ns) // 10**8
    times += [f"0.{each} s after" for each in range(1, min(after, 5) + 1)]
    assert [*beside] == times


def test_a_depth_map_is_no_scan():
    frame = street_frame(0)
    frame = Frame(frame.image, Depth(np.ones(frame.size, np.float32)))
    with pytest.raises(InputError, match="the recording has depth maps, or no calibration"):
        list(choose_frames(source_of([frame]), 3))


def test_scans_are_compared_at_the_time_of_the_image():
    """The car drives 10 m/s ahead, and the image is 0.1 s later than the scan."""
    moved = np.eye(4)
    moved[0, 3] = 1
    track = PoseTrack.of([np.eye(4), moved], [0, 10**8])
    points = scan_of(np.full((120, 360), 10, np.float32))
    image = Image(street_frame(0).rgb, stamp_ns=10**8)
    frame = Frame(image, Scan(points, 0), calibration=street_frame(0).calibration, poses=track)
    assert np.allclose(compensated_points(frame)[:, 0], points[:, 0] - 1, atol=1e-3)
