"""Cityscapes: images, label ids, disparities and cameras, a folder a city."""

import json

import numpy as np

from layouts.pictures import write

HEIGHT, WIDTH = 6, 34
STEM = "aachen/aachen_000000_000019"
CAMERA = {
    "extrinsic": {
        "baseline": 0.209313,
        "pitch": 0.038,
        "roll": 0.0,
        "x": 1.7,
        "y": 0.1,
        "yaw": -0.0195,
        "z": 1.22,
    },
    "intrinsic": {"fx": 2262.52, "fy": 2265.3017905988554, "u0": 1096.98, "v0": 513.137},
}


def write_frame(root, stem=STEM, split="train", *, magnify=1):
    """A column a label id; the disparity of row r is the stored value r."""
    image = np.full((HEIGHT, WIDTH, 3), (200, 20, 40), np.uint8)
    write(root / "leftImg8bit" / split / f"{stem}_leftImg8bit.png", image, magnify)
    labels = np.broadcast_to(np.arange(WIDTH, dtype=np.uint8), (HEIGHT, WIDTH))
    write(root / "gtFine" / split / f"{stem}_gtFine_labelIds.png", labels, magnify)


def write_stereo(root, stem=STEM, split="train", *, magnify=1):
    disparity = np.zeros((HEIGHT, WIDTH), np.uint16)
    disparity[:] = np.array([0, 1, 2, 257, 25601, 65535])[:, None]
    write(root / "disparity" / split / f"{stem}_disparity.png", disparity, magnify)
    camera = root / "camera" / split / f"{stem}_camera.json"
    camera.parent.mkdir(parents=True, exist_ok=True)
    camera.write_text(json.dumps(CAMERA))
