"""A video and the depth maps beside it through ssdnet-run."""

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.sources.video import VideoSource

N, RATE_HZ = 8, 20


@pytest.fixture
def video(tmp_path):
    """N frames at 20 Hz, frame i of the mean red 20 i + 20; losses of coding are a few units."""
    path = tmp_path / "drive.mp4"
    write_video(path, "mp4v")
    return path


def write_video(path, codec):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), RATE_HZ, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV writes no {codec}")
    for index in range(N):
        image = np.full((48, 64, 3), (90, 60, red_of(index)), np.uint8)
        image[:, :32] += 10
        image[:, 32:] -= 10
        writer.write(image)
    writer.release()


def red_of(index):
    return 20 * index + 20


@pytest.fixture
def depth_maps(tmp_path, make_frame, write_depth):
    for index in range(N):
        write_depth(tmp_path / f"lidar/depth_{index:03d}.png", make_frame(seed=index)[1])
    return tmp_path / "lidar"


def test_a_video_from_end_to_end(video, depth_maps, run, make_frame):
    answers = run(video, "--depth", depth_maps)
    assert answers.exit_code == 0, answers.text
    assert answers.names == [f"{index:06d}" for index in range(N)]
    for index in range(N):
        expected = make_frame(seed=index)[1]
        assert abs(answers.fed_depth(f"{index:06d}") - expected).max() < 0.01
    stamps = [int(ns) for ns in answers.column("image_stamp_ns")]
    assert np.allclose(np.diff(stamps), 1e9 / RATE_HZ, atol=1e6)
    assert answers.report["inputs"]["video"] == str(video)


def test_frames_may_be_read_in_any_order(video):
    with VideoSource(video) as source:
        frames = source.list_frames()
        for index in (0, 0, 1, 5, 2, 7, 7):
            red, green, blue = source.read(frames[index]).rgb.reshape(-1, 3).mean(axis=0)
            assert abs(red - red_of(index)) < 6, index
            assert abs(green - 60) < 6
            assert abs(blue - 90) < 6


def test_without_depth_maps_the_camera_alone_is_answered(video, run):
    answers = run("--source", f"video:{video}", "--limit", 3)
    assert answers.exit_code == 0, answers.text
    assert answers.names == ["000000", "000001", "000002"]
    assert set(answers.column("degraded")) == {"no_depth"}


def test_no_output_takes_the_place_of_the_video_that_is_read(video, run):
    before = video.read_bytes()
    answers = run("--source", f"video:{video}", "--video", video, "--overwrite")
    assert answers.exit_code == 1
    assert "drive.mp4 is what the run reads: choose another name" in answers.text
    assert video.read_bytes() == before
    answers = run("--source", f"video:{video}", "--video", video.with_name("answers.mp4"))
    assert answers.exit_code == 0, answers.text


def test_frames_and_depth_maps_without_a_partner_are_counted(video, depth_maps, run):
    (depth_maps / "depth_003.png").unlink()
    (depth_maps / "depth_000.png").rename(depth_maps / f"depth_{N + 3:03d}.png")
    answers = run("--source", f"video:{video}", "--depth", depth_maps)
    assert answers.exit_code == 3
    reasons = dict(zip(answers.names, answers.column("reason"), strict=True))
    assert reasons.pop("000000") == "000000 is in the video, but has no depth map"
    assert reasons.pop("000003") == "000003 is in the video, but has no depth map"
    assert reasons.pop(f"{N + 3:06d}").endswith("has a depth map, but the video has no such frame")
    assert not any(reasons.values())


def test_maps_that_count_from_one_are_an_error(video, depth_maps, run):
    for index in reversed(range(N)):
        (depth_maps / f"depth_{index:03d}.png").rename(depth_maps / f"depth_{index + 1:03d}.png")
    answers = run("--source", f"video:{video}", "--depth", depth_maps)
    assert answers.exit_code == 1
    assert "numbered from 0" in answers.text.replace("\n", " ")


def test_shards_of_a_video_are_together_the_whole(video, depth_maps, run):
    source = ["--source", f"video:{video}", "--depth", depth_maps]
    whole = run(*source)
    parts = [run(*source, "--shard", f"{part}/3", out=f"part{part}") for part in (1, 2, 3)]
    assert sorted(name for part in parts for name in part.names) == whole.names
    for part in parts:
        for name in part.names:
            assert np.array_equal(part.fed_depth(name), whole.fed_depth(name))


@pytest.mark.parametrize("share", [0, 0.02, 0.5])
def test_a_truncated_video_is_an_input_error(video, tmp_path, share):
    content = video.read_bytes()
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"cut\.mp4"):
        VideoSource(cut).list_frames()


def test_a_video_that_ends_early_is_answered_up_to_there(tmp_path, run):
    """Motion JPEG in AVI has its header first: what is missing shows when it is read."""
    path = tmp_path / "drive.avi"
    write_video(path, "MJPG")
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"\xff\xd8\xff") - 100])
    answers = run("--source", f"video:{path}")
    assert answers.exit_code == 3, answers.text
    assert answers.column("status") == ["ok"] * (N - 2) + ["skipped"] * 2
    assert "ends or is damaged before its frame 7" in answers.column("reason")[7]


def test_frames_that_no_header_counts_are_counted(tmp_path):
    """Pictures one after the other, as some cameras write them."""
    pictures = [np.full((48, 64, 3), (90, 60, red_of(index)), np.uint8) for index in range(N)]
    content = b"".join(cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures)
    (tmp_path / "drive.mjpeg").write_bytes(content)
    with VideoSource(tmp_path / "drive.mjpeg") as source:
        frames = source.list_frames()
        reds = [source.read(frame).rgb[..., 0].mean() for frame in frames]
    assert np.allclose(reds, [red_of(index) for index in range(N)], atol=6)


def test_a_depth_map_without_a_number_is_an_error(video, depth_maps, run):
    (depth_maps / "depth_003.png").rename(depth_maps / "first.png")
    answers = run("--source", f"video:{video}", "--depth", depth_maps)
    assert answers.exit_code == 1
    assert "must end in the number of its frame" in answers.text.replace("\n", " ")


def test_what_is_no_video_is_an_error(tmp_path, run):
    (tmp_path / "drive.mp4").write_bytes(b"no video" * 100)
    answers = run("--source", f"video:{tmp_path / 'drive.mp4'}")
    assert answers.exit_code == 1
    assert "cannot read the video" in answers.text.replace("\n", " ")
