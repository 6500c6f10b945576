"""KITTI's depth completion benchmark: drives and the selected validation set."""

import numpy as np

from layouts.pictures import write

SIZE = (5, 8)
DATE = "2011_09_26"
DRIVE = f"{DATE}_drive_0001_sync"
# The benchmark leaves out the first five frames of a drive.
NUMBERS = ("0000000005", "0000000006")
CALIBRATION = """\
calib_time: 09-Jan-2012 13:57:47
P_rect_02: 721.5 0 609.5 44.8 0 722.5 172.8 0.2 0 0 1 0.002
P_rect_03: 731.5 0 619.5 -339.5 0 732.5 182.8 2.1 0 0 1 0.003
"""


def rgb(red=200):
    return np.full((*SIZE, 3), (red, 20, 40), np.uint8)


def lidar():
    """One return at 10.25 m."""
    stored = np.zeros(SIZE, np.uint16)
    stored[2, 3] = 2624
    return stored


def truth():
    """That return and one more, at 1 / 256 m and 65534 / 256 m."""
    stored = np.zeros(SIZE, np.uint16)
    stored[2, 3], stored[4, 7] = 1, 65534
    return stored


def write_drive(root, split="train", drive=DRIVE, *, magnify=1):
    date = drive[:10]
    for camera in (2, 3):
        side = f"image_{camera:02d}"
        for number in NUMBERS:
            maps = root / split / drive / "proj_depth"
            write(maps / "velodyne_raw" / side / f"{number}.png", lidar(), magnify)
            write(maps / "groundtruth" / side / f"{number}.png", truth(), magnify)
        for number in ("0000000004", *NUMBERS):
            image = rgb(100 * (camera - 1))
            write(root / "raw" / date / drive / side / "data" / f"{number}.png", image, magnify)
    (root / "raw" / date / "calib_cam_to_cam.txt").write_text(CALIBRATION)


def write_selection(root, *, magnify=1):
    folder = root / "val_selection_cropped"
    for drive, number, camera in (("0002", 5, 2), ("0023", 7, 3)):
        name = f"{DATE}_drive_{drive}_sync_{{}}_{number:010d}_image_{camera:02d}"
        for kind, word, image in (
            ("image", "image", rgb()),
            ("velodyne_raw", "velodyne_raw", lidar()),
            ("groundtruth_depth", "groundtruth_depth", truth()),
        ):
            write(folder / kind / f"{name.format(word)}.png", image, magnify)
        numbers = folder / "intrinsics" / f"{name.format('image')}.txt"
        numbers.parent.mkdir(exist_ok=True)
        numbers.write_text(f"721.5 0.0 596.5 0.0 722.5 149.8{camera} 0.0 0.0 1.0")
