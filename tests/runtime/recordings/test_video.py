"""A video and the depth maps beside it through ssdnet-run."""

import re
import struct

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.recordings import video as video_module
from runtime.recordings.video import VideoSource
from small_rig import write_video

N, RATE_HZ = 8, 20


@pytest.fixture
def video(tmp_path):
    """N frames at 20 Hz, frame i of the mean red 20 i + 20; losses of coding are a few units."""
    return write_video(tmp_path / "drive.mp4", "mp4v", COLOURS)


def red_of(index):
    return 20 * index + 20


COLOURS = [(90, 60, red_of(index)) for index in range(N)]


@pytest.fixture
def depth_maps(tmp_path, make_frame, write_depth):
    for index in range(N):
        write_depth(tmp_path / f"lidar/depth_{index:03d}.png", make_frame(seed=index)[1])
    return tmp_path / "lidar"


def test_a_video_from_end_to_end(video, depth_maps, run, make_frame):
    answers = run(video, "--depth", depth_maps)
    answers.require({f"{index:06d}": make_frame(seed=index)[1] for index in range(N)})
    stamps = [int(ns) for ns in answers.column("image_stamp_ns")]
    assert np.allclose(np.diff(stamps), 1e9 / RATE_HZ, atol=1e6)
    assert answers.report["inputs"]["rgb"] == str(video)


def test_frames_may_be_read_in_any_order(video):
    with VideoSource(video) as source:
        frames = source.list_frames()
        for index in (0, 0, 1, 5, 2, 7, 7):
            mean = source.read(frames[index]).rgb.mean(axis=(0, 1))
            np.testing.assert_allclose(mean, (red_of(index), 60, 90), atol=6)


class Unwritten:
    """A video of which OpenCV reports frames as decoded whose pixels it did not write."""

    def __init__(self, video, unwritten):
        self.video, self.unwritten, self.next = video, unwritten, 0
        self.buffer = np.zeros((48, 64, 3), np.uint8)

    def __getattr__(self, name):
        return getattr(self.video, name)

    def grab(self):
        self.next += 1
        return self.video.grab()

    def read(self):
        done, decoded = self.video.read()
        if self.next not in self.unwritten:
            self.buffer = decoded
        self.next += 1
        return done, self.buffer


@pytest.mark.parametrize("unwritten", [(), (2, 5), range(N)])
def test_frames_whose_pixels_are_not_written_are_damaged(video, monkeypatch, unwritten):
    """Such a frame is black, or a copy of the frame before, as after an interlaced frame."""
    opened = video_module._open

    def opened_unwritten(path, **options):
        return Unwritten(opened(path, **options), unwritten)

    monkeypatch.setattr(video_module, "_open", opened_unwritten)
    with VideoSource(video) as source:
        for index, frame in enumerate(source.list_frames()):
            if index in unwritten:
                with pytest.raises(InputError, match=rf"frame {index} of .*'FMP4'.*yadif"):
                    source.read(frame)
            else:
                red = source.read(frame).rgb[..., 0].mean()
                np.testing.assert_allclose(red, red_of(index), atol=6)


def test_a_video_may_repeat_frames(tmp_path):
    greys = (80, 80, 120, 120, 120)
    with VideoSource(write_video(tmp_path / "slow.avi", "MJPG", greys)) as source:
        means = [source.read(frame).rgb.mean() for frame in source.list_frames()]
    np.testing.assert_allclose(means, greys, atol=6)


def test_frames_and_depth_maps_without_a_partner_are_listed(video, depth_maps):
    (depth_maps / "depth_003.png").unlink()
    (depth_maps / "depth_000.png").rename(depth_maps / f"depth_{N + 3:03d}.png")
    with VideoSource(video, depth=depth_maps) as source:
        frames = source.list_frames()
    assert {int(each.name) for each in frames if not each.complete} == {0, 3, N + 3}


def test_maps_that_count_from_one_are_an_error(video, depth_maps):
    for index in reversed(range(N)):
        (depth_maps / f"depth_{index:03d}.png").rename(depth_maps / f"depth_{index + 1:03d}.png")
    with pytest.raises(InputError, match="from 0"):
        VideoSource(video, depth=depth_maps).list_frames()


@pytest.mark.parametrize("share", [0, 0.02, 0.5, None])
def test_a_truncated_video_is_an_input_error(video, tmp_path, share):
    content = video.read_bytes()
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(b"no video" * 100 if share is None else content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"cut\.mp4"):
        VideoSource(cut).list_frames()


@pytest.mark.parametrize("stated", [0, 1, N, 3 * N, 2**31])
def test_frames_are_those_of_the_video_not_of_its_header(tmp_path, stated):
    path = write_video(tmp_path / "drive.avi", "MJPG", COLOURS)
    content = bytearray(path.read_bytes())
    for mark, place in ((b"strh", 40), (b"avih", 24)):
        struct.pack_into("<I", content, content.find(mark) + place, stated)
    path.write_bytes(content)
    with VideoSource(path) as source:
        frames = source.list_frames()
        reds = [source.read(frame).rgb[..., 0].mean() for frame in frames]
        np.testing.assert_allclose(reds, [red_of(index) for index in range(N)], atol=6)
        assert bool(source.notes) == (stated not in (0, N)), source.notes  # 0: it states none
        assert len(source.list_frames(limit=3)) == 3


def element(identity, content):
    """An element of Matroska."""
    return bytes.fromhex(identity) + (1 << 56 | len(content)).to_bytes(8, "big") + content


def number(identity, value):
    return element(identity, value.to_bytes(4, "big"))


def write_mkv(path, times_ms):
    """Write Motion JPEG in Matroska, a cluster a frame."""
    scale = number("2AD7B1", 10**6)
    duration = element("4489", struct.pack(">d", times_ms[-1] + 33.0))
    size = element("E0", number("B0", 64) + number("BA", 48))
    codec = element("86", b"V_MJPEG")
    track = number("D7", 1) + number("73C5", 1) + number("83", 1) + codec + size
    body = element("1549A966", scale + duration) + element("1654AE6B", element("AE", track))
    for index, time_ms in enumerate(times_ms):
        jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), index + 1, np.uint8))[1].tobytes()
        block = element("A3", b"\x81\0\0\x80" + jpeg)
        body += element("1F43B675", number("E7", time_ms) + block)
    head = element("4282", b"matroska") + number("4287", 2) + number("4285", 2)
    path.write_bytes(element("1A45DFA3", head) + element("18538067", body))
    return path


def test_frames_of_a_variable_rate_are_all_read(tmp_path):
    """Slow, then fast: from rate and duration OpenCV estimates many more."""
    times_ms = [100 * index for index in range(20)] + [2000 + 33 * index for index in range(40)]
    with VideoSource(write_mkv(tmp_path / "drive.mkv", times_ms)) as source:
        frames = [source.read(frame) for frame in source.list_frames()]
    assert [round(frame.image.stamp_ns / 1e6) for frame in frames] == times_ms


def test_a_damaged_frame_does_not_shift_those_behind_it(tmp_path):
    path = write_video(tmp_path / "drive.avi", "MJPG", COLOURS)
    content = path.read_bytes()
    starts = [found.start() for found in re.finditer(b"\xff\xd8\xff", content)]
    path.write_bytes(content[: starts[2]] + bytes(200) + content[starts[2] + 200 :])
    with VideoSource(path) as source:
        frames = source.list_frames()
        with pytest.raises(InputError, match="this frame is damaged"):
            source.read(frames[2])
        for index in (3, 5, 4, N - 1):
            red = source.read(frames[index]).rgb[..., 0].mean()
            assert abs(red - red_of(index)) < 8


def turn(path, degrees):
    """Write the matrix of a turn into the header of a video (ISO/IEC 14496-12, 8.3.2)."""
    content, one = bytearray(path.read_bytes()), 1 << 16
    turned = {90: (0, one, 0, -one, 0, 0, 48 * one, 0), 180: (-one, 0, 0, 0, -one, 0, 0, 0)}
    at = content.find(b"tkhd") + 44
    content[at : at + 32] = struct.pack(">8i", *turned[degrees])
    path.write_bytes(content)


@pytest.mark.parametrize("degrees", [90, 180])
def test_a_turned_video_is_said_and_read_as_it_is_stored(video, run, degrees):
    with VideoSource(video) as source:
        stored = source.read(source.list_frames()[0]).rgb
        assert not source.notes
    turn(video, degrees)
    with VideoSource(video) as source:
        assert np.array_equal(source.read(source.list_frames()[0]).rgb, stored)
        assert f"the video's header turns them by {degrees} degrees" in "".join(source.notes)
