"""Picture files, whole and damaged."""

import cv2


def write(path, image, magnify=1):
    """Write a picture; colours are RGB."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = image.repeat(magnify, axis=0).repeat(magnify, axis=1)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def read(path):
    """The numbers that a picture stores."""
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def cut_short(path):
    path.write_bytes(path.read_bytes()[:-20])
