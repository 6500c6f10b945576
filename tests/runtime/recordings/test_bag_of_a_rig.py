"""A bag of two cameras and one LiDAR through ssdnet-run: each camera in turn, and one report."""

import signal

import pytest

from runtime import InputError, Predictor
from runtime.recordings.bag import BagSource
from small_rig import MS, SIZE, START_NS

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

TOPICS = {"front-image_rect": "/front/image_rect", "rear-image_rect": "/rear/image_rect"}
FOCAL_PX = {"front-image_rect": 60.0, "rear-image_rect": 90.0}
# Cameras look along z with x to the right, bodies along x with y to the left (REP 103).
AHEAD, BACK = (-0.5, 0.5, -0.5, 0.5), (0.5, 0.5, -0.5, -0.5)
N = 4


@pytest.fixture
def rig(make_bag, make_frame, make_scan):
    """The path of a bag: N images in front, one fewer at the rear, and N scans all around."""
    bag = make_bag()
    for number, (name, topic) in enumerate(TOPICS.items()):
        place = name.split("-")[0]
        for index in range(N - number):
            rgb, _ = make_frame(*SIZE, seed=10 * number + index)
            stamp_ns = START_NS + (100 * index + 3 * number) * MS
            bag.image(topic, rgb, "rgb8", stamp_ns, frame_id=place)
        matrix = [[FOCAL_PX[name], 0, 32], [0, FOCAL_PX[name], 24], [0, 0, 1]]
        bag.info(f"/{place}/camera_info", matrix, SIZE, frame_id=place)
    for index in range(N):
        scan = make_scan(index)
        scan[::2, :2] *= -1  # half of them behind
        bag.cloud("/lidar/points", scan, START_NS + (100 * index + 7) * MS)
    bag.static_transform("lidar", "front", AHEAD, (0.5, 0, 0))
    bag.static_transform("lidar", "rear", BACK, (-0.5, 0, 0))
    return bag.write()


@pytest.fixture
def source(rig):
    return f"bag:{rig},image_topic={'+'.join(TOPICS.values())}"


def test_each_camera_has_the_answers_of_a_run_of_its_own(rig, source, run, tmp_path):
    pages = ["--page", tmp_path / "page.html", "--record", tmp_path / "recording"]
    whole = run("--source", source, *pages)
    assert whole.exit_code == 0, whole.text
    expected = []
    for name, topic in TOPICS.items():
        alone = run("--source", f"bag:{rig},image_topic={topic}", out=f"alone-{name}")
        assert alone.exit_code == 0, alone.text
        expected += [f"{name}/{frame}" for frame in alone.names]
        inputs = whole.report["inputs"]["cameras"][name]
        assert inputs == alone.report["inputs"]
        assert (inputs["image_topic"], inputs["focal_length_px"]) == (topic, FOCAL_PX[name])
        for frame in alone.names:
            file = f"depth/{frame}.png"
            answer = (tmp_path / "out" / name / file).read_bytes()
            assert answer == (tmp_path / f"alone-{name}" / file).read_bytes()
            assert (alone.fed_depth(frame) > 0).sum() > 50
        written = f"out/{name}/report.json", f"page-{name}.html", f"recording/{name}/"
        assert all((tmp_path / each).exists() for each in written)
    assert whole.names == expected
    assert len(expected) == 2 * N - 1
    assert whole.column("index") == [str(index) for index in range(len(expected))]
    assert whole.report["frames"]["total"] == len(expected)
    assert f"frames: {len(expected)} ({len(expected)} ok)" in whole.text


def test_only_an_earlier_run_is_replaced(source, run, tmp_path):
    assert run("--source", source, "--limit", 1).names == [
        f"{name}/{START_NS + 3 * number * MS}" for number, name in enumerate(TOPICS)
    ]
    assert "is not empty" in run("--source", source).text
    assert len(run("--source", source, "--overwrite").names) == 2 * N - 1
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").touch()
    assert run("--source", source, "--overwrite", out="foreign").exit_code == 1


def test_what_is_of_one_camera_is_refused_for_several(rig, source, run, tmp_path):
    for given in (
        ["--source", f"{source},info_topic=/front/camera_info"],
        ["--source", source, "--calibration", tmp_path / "calibration.toml"],
        ["--source", source, "--focal-length", 60],
        ["--source", f"bag:{rig},image_topic=/front/image_rect+/front-image_rect"],  # one folder
    ):
        answers = run(*given)
        assert answers.exit_code == 1
        assert "run each camera by itself" in answers.text.replace("\n", " ")
    answers = run("--source", f"bag:{rig},image_topic=/front/image_rect+/left/image_rect")
    assert "image_topic=/left/image_rect is not a topic" in answers.text.replace("\n", " ")
    taken = tmp_path / "video-rear-image_rect.mp4"
    taken.touch()
    assert f"{taken.name} exists" in run("--source", source, "--video", tmp_path / "video.mp4").text
    assert not (tmp_path / "out").exists(), "all of it is found before the first camera runs"


def test_ctrl_c_ends_the_rig_with_a_report_of_what_was_done(source, run, monkeypatch):
    predict = Predictor.predict
    counted = iter(range(100))

    def interrupted(self, rgb, sparse_depth=None, **options):
        # Warming up and the check before the stream ask the camera alone.
        if sparse_depth is not None and sparse_depth.any() and next(counted) == N - 1:
            signal.raise_signal(signal.SIGINT)  # in the last frame of the first camera
        return predict(self, rgb, sparse_depth, **options)

    monkeypatch.setattr(Predictor, "predict", interrupted)
    answers = run("--source", source)
    assert answers.exit_code == 3, answers.text
    assert answers.report["interrupted"]
    assert [name.split("/")[0] for name in answers.names] == ["front-image_rect"] * N


def test_the_error_of_a_camera_has_its_name(source, run):
    answers = run("--source", source, "--rectify")
    assert answers.exit_code == 1
    text = answers.text.replace("\n", " ")
    assert "error: front-image_rect: the images cannot be rectified" in text


def test_a_part_of_a_split_bag_names_the_whole(record):
    """Only the first part has /tf_static."""
    path = record("mcap", tree=False).write()
    (path.parent / "metadata.yaml").touch()
    with pytest.raises(InputError, match=f"give the whole bag {path.parent}, whose first file"):
        BagSource(path)
