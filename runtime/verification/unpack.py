"""A reference as plain files, for programs in other languages."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from runtime.contract.model_file import load_model_file
from runtime.engine.predictor import Predictor
from runtime.files.own_folder import atomic_folder
from runtime.verification.reference import MODEL_FILE, Reference

UNPACKED_FORMAT, UNPACKED_VERSION = "ssdnet-unpacked", "1.0"
MANIFEST_FILE = "manifest.json"


def unpack(
    reference: Reference, predictor: Predictor, path: Path, *, overwrite: bool = False
) -> None:
    """Write the frames and answers of a reference as `.npy` files, completely or not at all.

    The folder holds `manifest.json`, `model.onnx`, and a folder for each frame with one file per
    array, in C order and little-endian. The manifest states what a `Predictor` would compute: the
    focal length of each frame, and the size at which the network runs for it.

    Args:
        reference: the reference to be unpacked.
        predictor: a predictor of the recorded model with the recorded settings.
        path: the folder, which gets its name when it is complete.
        overwrite: replace a folder that this function wrote earlier; any other folder is never
            replaced.

    Raises:
        ContractError: if the recorded model cannot be read or has another SHA-256.
        InputError: if the reference is damaged.
        OutputError: if the folder cannot be written or replaced.
    """
    model = load_model_file(reference.model, sha256=reference.model_sha256)
    with atomic_folder(path, overwrite=overwrite) as folder:
        (folder / MODEL_FILE).write_bytes(model.content)
        frames: list[dict[str, Any]] = []
        for index, frame in enumerate(reference.frames):
            arrays = reference.arrays(index)
            height, width, _ = arrays["rgb"].shape
            name = f"{index:06}"
            (folder / name).mkdir()
            for array_name, values in arrays.items():
                plain = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
                np.save(folder / name / f"{array_name}.npy", plain, allow_pickle=False)
            facts = {"folder": name, **asdict(frame), "arrays": [*arrays]}
            facts["focal_length_px"] = frame.focal_length_px or predictor.focal_length_px
            facts["network_size"] = predictor.network_size((height, width))
            frames.append(facts)
        document = {
            "format": UNPACKED_FORMAT,
            "version": UNPACKED_VERSION,
            "model": {
                "file": MODEL_FILE,
                "name": reference.model_name,
                "sha256": reference.model_sha256,
            },
            "limits": reference.limits,
            "frames": frames,
        }
        (folder / MANIFEST_FILE).write_text(json.dumps(document, indent=1, allow_nan=False))
