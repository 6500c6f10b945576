"""The engine's answers from bare ONNX Runtime alone, for ports to other languages.

    python examples/bare_onnxruntime.py MODEL.onnx RGB.png DEPTH.png [FOCAL_LENGTH_PX]

Nothing of this project is imported. `predict` answers as `Predictor` does, without its checks of
arrays, file and answers (docs/model_file.md lists them), and without moving the depth of a large
frame to the frame's own returns.
"""

import json
import sys

import cv2
import numpy as np
import onnxruntime


def open_model(path: str) -> tuple[onnxruntime.InferenceSession, dict]:
    """The session and the metadata of the file."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session, json.loads(session.get_modelmeta().custom_metadata_map["ssdnet"])


def predict(
    session: onnxruntime.InferenceSession,
    contract: dict,
    rgb: np.ndarray,
    sparse_depth: np.ndarray,
    focal_length_px: float | None = None,
) -> dict[str, np.ndarray]:
    """Head -> answer at the frame's size, of uint8 (H, W, 3) and float32 (H, W) [m]."""
    frame = height, width = rgb.shape[:2]
    size = session.get_inputs()[0].shape[1:3]
    if not isinstance(size[0], int):  # free size: the trained height, if the frame is much larger
        rows = contract.get("trained_height") or height
        size = (rows, max(32, round(width * rows / height))) if height > 1.25 * rows else frame
    factor = 1.0  # to the metres of the model's canonical camera
    if focal_length_px and contract.get("canonical_focal_px"):
        magnified = np.sqrt(size[0] * size[1] / (height * width))
        factor = contract["canonical_focal_px"] / (focal_length_px * magnified)
    # Each usable return moves to pixel rint((u + 0.5) * new / old - 0.5), where the nearest stays.
    usable = (sparse_depth > 0) & (sparse_depth <= max(contract["max_depth_m"] / factor, 250))
    places = zip(np.nonzero(usable), size, frame, strict=True)
    to = [np.rint(((2 * u + 1) * new - old) / (2 * old)).astype(int) for u, new, old in places]
    fed = np.full(size, np.inf, np.float32)
    np.minimum.at(fed, tuple(to), sparse_depth[usable])
    fed = np.where(np.isinf(fed), np.float32(0), fed) * np.float32(factor)
    fed = np.minimum(fed, np.float32(contract["max_depth_m"]))
    feed = {"rgb": resize(rgb, size)[None], "sparse_depth": fed[None]}
    heads = [tensor.name for tensor in session.get_outputs() if len(tensor.shape) == 3]
    answers = {}
    for head, (values,) in zip(heads, session.run(heads, feed), strict=True):
        if head in ("depth", "depth_uncertainty"):
            values = values * np.float32(1 / factor)
        if head == "boundary":
            answers[head] = resize(values, frame)
        else:  # classes are never interpolated, depths within a surface
            answers[head] = cv2.resize(values, frame[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
            if head == "depth" and frame[0] >= size[0] and frame[1] >= size[1]:
                smooth_surfaces(values, answers[head])
    return answers


def smooth_surfaces(depth: np.ndarray, enlarged: np.ndarray) -> None:
    """Interpolate inverse depth where the 3 x 3 pixels around differ by at most 15 %, in place."""
    size, around = enlarged.shape[::-1], np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(depth, around), cv2.dilate(depth, around)
    is_surface = ((nearest > 0) & (farthest <= 1.15 * nearest)).astype(np.uint8)
    is_surface = cv2.resize(is_surface, size, interpolation=cv2.INTER_NEAREST_EXACT)
    inverse = cv2.resize(cv2.divide(1.0, depth), size, interpolation=cv2.INTER_LINEAR)
    cv2.copyTo(cv2.divide(1.0, inverse), is_surface, enlarged)


def resize(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Area interpolation along each side that shrinks, bilinear along one that grows."""
    smaller = min(size[0], image.shape[0]), min(size[1], image.shape[1])
    image = cv2.resize(image, smaller[::-1], interpolation=cv2.INTER_AREA)
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_LINEAR)


def main() -> None:
    """Answer one frame of files, KITTI's depth PNG."""
    if len(sys.argv) not in (4, 5):
        raise SystemExit(__doc__)
    session, contract = open_model(sys.argv[1])
    rgb = cv2.imread(sys.argv[2], cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    sparse_depth = cv2.imread(sys.argv[3], cv2.IMREAD_UNCHANGED) / np.float32(256)
    focal_length_px = float(sys.argv[4]) if len(sys.argv) > 4 else None
    for head, values in predict(session, contract, rgb, sparse_depth, focal_length_px).items():
        print(f"{head}: {values.dtype} {values.shape}, {values.min()} to {values.max()}")


if __name__ == "__main__":
    main()
