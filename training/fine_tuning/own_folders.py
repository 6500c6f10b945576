"""The recipe for folders of images, labels and depth maps: what it needs is read from them."""

import itertools
import os
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from tqdm import tqdm

from models import Network
from models.checkpoint import RECIPE
from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.contract.contract import ClassInfo
from runtime.contract.network_size import LARGEST_RATIO, network_size
from runtime.files.atomic_write import atomic_write
from runtime.files.read_input import MAX_FILE_BYTES, open_input, read_text, read_toml
from runtime.recordings.images import image_size, list_files, read_rgb
from runtime.recordings.registry import SOURCES
from training.base.palette import Palette
from training.base.tables import quoted, to_toml
from training.datasets.class_list import read_class_list, read_labels
from training.datasets.class_names import relatives
from training.datasets.folders import FoldersRecipe
from training.datasets.recording import RecordingRecipe, beside
from training.datasets.sample import Sample
from training.fine_tuning.adaptation_frames import describe_recording, is_named
from training.fine_tuning.likeness import find_alike
from training.run.recipe import change
from training.run.run_folder import folder_errors
from training.scores.differences import LEAST_DRAWN
from training.weights.initial_weights import Weights

# The file of the recipe in a run's folder.
RECIPE_TEXT = "recipe.toml"
_BATCH = 4
# Epochs, if the number of steps is within its limits: with 70 steps, twenty pictures gained.
_PASSES, _MIN_STEPS, _MAX_STEPS = 20, 70, 10_000
# Only the last layers of the classes are trained: the depth head reads the features of the classes,
# and training them further made the depth a third worse in 150 steps. The rate is that of layers
# which begin at random.
_CLASSES_ALONE = {"only": ["semantic_"], "frozen": ["semantic_decoder"], "learning_rate": 2e-3}
# In 70 steps half of the start remains in the average: weights that only twenty pictures have moved
# answer too much as the rare classes of these. A class that begins at random would suffer.
_HALF_OF_START = {"ema_decay": 0.99, "ema_keeps_start": True}
# One frame in this number is for validation, but no fewer than the least that give a verdict.
_VALIDATION, _LEAST_APART = 10, LEAST_DRAWN
# The least number of frames.
_LEAST_FRAMES = 10
# Number of places of which frames are kept apart.
_PLACES = 3
# Fewer frames give scores that say little.
_FEW_FRAMES = 60
# Number of frames in which the meaning of classes is looked for.
_LOOKED_AT = 10
# A gap between the numbers of two frames, in median gaps, from which they are of two places.
_PLACE_GAP = 5


@dataclass(frozen=True)
class OwnFolders:
    """Folders whose files are paired by their names, with labels, depth or both.

    The attributes are described in `training.api.finetune`.
    """

    images: Path
    labels: Path | None = None
    depth: Path | None = None
    classes: Path | None = None
    ignore: Sequence[str] = ()
    palette: Palette | None = None
    depth_scale: float | None = None
    focal_length_px: float | None = None
    intrinsics: tuple[float, float, float, float] | None = None
    points: Path | None = None
    calibration: Path | None = None

    def __post_init__(self) -> None:
        """Check that there is something to learn, and that the options go together."""
        stated = (self.depth_scale, self.focal_length_px, self.intrinsics)
        if self.recording and any(item is not None for item in stated):
            raise InputError(
                "--depth-scale, --focal-length and --intrinsics describe folders of depth maps: "
                "state them in --calibration, or as keys of KIND:PATH,KEY=VALUE"
            )
        if self.depth is None and self.depth_scale is not None:
            raise InputError("--depth-scale is the unit of --depth: give both, or neither")
        if self.focal_length_px is not None and self.intrinsics is not None:
            raise InputError("--focal-length and --intrinsics state the same: give one of them")
        if self.labels is None and self.depth is None and self.recording is None:
            raise InputError("images alone teach nothing: give --labels with --classes, or --depth")
        if (self.labels is None) != (self.classes is None):
            raise InputError("labels are ids of classes: give --labels and --classes, or neither")

    @cached_property
    def recording(self) -> tuple[RecordingRecipe, Path] | None:
        """A recording and the folder that holds it; None for folders of images and depth maps."""
        path = self.images
        others = [source for kind, source in SOURCES.items() if kind != "folders"]
        if self.points or self.calibration or is_named(str(path)):
            found = True
        else:  # a folder of images may look like another kind, too
            is_folder = path.is_dir() and SOURCES["folders"].accepts(path)
            found = not is_folder and any(source.accepts(path) for source in others)
        if not found:
            return None
        files = {name: getattr(self, name) for name in ("depth", "points", "calibration")}
        return describe_recording(str(path), **files)

    @property
    def root(self) -> Path:
        """The recipe's `--data`: the folder that holds the images' folder, or the recording."""
        return self.recording[1] if self.recording else self.images.resolve().parent

    def make_recipe(self, init: Weights, fold: int | None = None, folds: int = 0) -> dict[str, Any]:
        """Return the tables of a recipe for a training that starts from `init`.

        A tenth of the frames, at least six, is for validation: blocks of neighbours, which are
        alike, from three places. With `folds` it is the block of that number of so many; without a
        number all frames are trained on, and none are for validation. Images
        of far more rows than those `init` was trained on are resized to its rows, and images of
        far different sizes to the median of their rows; each keeps its aspect. Classes are learned
        by their own layers, and so is the depth without labels: the others stay those of `init`.

        Raises:
            InputError: if a folder or the classes cannot be read, for too few images, and where
                over a tenth of them differ in their rows by more than twice.
            DatasetError: for images without labels or depth.
        """
        if folds == 1:
            raise InputError("--folds 1 leaves no frames to train on: give 2 or more, or none")
        classes, meaning = self._learned_classes()
        keys = (self._keys_of_recording() or self._keys_of_folders()) | meaning
        recipe = RecordingRecipe(**keys) if self.recording else FoldersRecipe(**keys)
        folder, named = self.root / recipe.path, classes or "camvid"
        frames = recipe.open(folder, named)
        count = len(frames)
        if count < _LEAST_FRAMES:
            raise InputError(
                f"{self.images}: {count} images; expected at least {_LEAST_FRAMES}, of which "
                f"{_LEAST_APART} are for validation: add images with their labels or depth"
            )
        if self.focal_length_px is not None:
            height, width = read_rgb(frames.images[0]).shape[:2]
            keys["intrinsics"] = (*[self.focal_length_px] * 2, (width - 1) / 2, (height - 1) / 2)
        heights = [_read_height(path) for path in frames.images] or [frames[0].size[0]]
        rows = self._choose_rows(heights, init.facts.trained_height)
        if any(max(each, rows) > LARGEST_RATIO * min(each, rows) for each in heights):
            keys["size"] = rows
            frames = replace(recipe, size=rows).open(folder, named)
        apart = _choose_apart(frames.names, fold, folds)
        if not folds and count < _FEW_FRAMES:
            text = f"only {len(apart)} of {count} frames are kept apart, which say little: label "
            tqdm.write(
                text + "more, or give --folds 5, which scores on all of them", file=sys.stderr
            )
        trained = sorted({*range(count)} - {*apart})
        looked_at = (frames[each] for each in trained[:: -(-len(trained) // _LOOKED_AT)])
        origins = self._origins(classes, looked_at, init)
        infos = [{**asdict(info), "of": origins[info.name]} for info in classes]
        tables = _make_tables(infos, rows, keys, trained, apart)
        return tables | _choose_layers(init.network, infos)

    def _learned_classes(self) -> tuple[tuple[ClassInfo, ...], dict[str, Any]]:
        """Return the classes that are learned, and the keys that say what the labels mean."""
        if self.classes is None or self.labels is None:
            return (), {}
        return read_labels(self.classes, self.labels, ignore=self.ignore, palette=self.palette)

    def _relatives(self, init: Weights) -> dict[str, tuple[str, ...]]:
        """Return, for the name of each class, the classes of `init` with which it begins."""
        known = [info.name for info in init.network.config.classes]
        found = {}
        for item in () if self.classes is None else read_class_list(self.classes):
            parts = [relatives(name, known) for name in item.relatives or (item.name,)]
            if item.relatives and not all(parts):
                text = shown(item.relatives[parts.index(())])
                raise InputError(
                    f"{self.classes}: line {item.line} unites {text}, which {init.path.name} does "
                    f"not have: name some of {', '.join(known)}"
                )
            found[item.name] = tuple(dict.fromkeys(name for part in parts for name in part))
        return found

    def _origins(
        self, classes: Sequence[ClassInfo], samples: Iterable[Sample], init: Weights
    ) -> dict[str, tuple[str, ...]]:
        """Return `_relatives`, and what frames with labels show of classes that have none."""
        origins = self._relatives(init)
        alike = find_alike(samples, init, {info.name: origins[info.name] for info in classes})
        for name, others in alike.items():
            text = f"{name} begins with {', '.join(others)}, as {init.path.name} answers its pixels"
            tqdm.write(f"{text}; a line {name} = ... of --classes names others", file=sys.stderr)
        return origins | alike

    def _keys_of_recording(self) -> dict[str, Any]:
        """Return the keys of the set, with its labelled frames; nothing for folders."""
        if self.recording is None:
            return {}
        recording, root = self.recording
        names = ("kind", "path", "source", "keys", "depth", "points", "calibration")
        keys = {name: getattr(recording, name) for name in names if getattr(recording, name)}
        if self.labels is not None:
            path, labelled = root / recording.path, list_files(self.labels, (".png",))
            listed = recording.open_source(path).list_frames()
            keys["labels"] = os.path.relpath(self.labels.absolute(), beside(path))
            keys["frames"] = tuple(each.sequence for each in listed if each.name in labelled)
            if not keys["frames"]:
                raise InputError(
                    f"{self.labels}: no file is named like one of the {len(listed)} frames, such "
                    f"as {listed[0].name}.png"
                )
        return keys

    def _keys_of_folders(self) -> dict[str, Any]:
        """Return the keys of the set: its folders, and what was stated."""
        # The set is the images' folder: a run's files beside it are not files of the data.
        images = self.images.resolve()
        keys: dict[str, Any] = {"path": images.name, "rgb": "."}
        for key, folder in (("labels", self.labels), ("depth", self.depth)):
            if folder is not None:
                keys[key] = os.path.relpath(folder.resolve(), images)
        stated: dict[str, Any] = {
            "scan": None if self.depth is None else True,
            "depth_scale": self.depth_scale,
            "intrinsics": self.intrinsics,
        }
        return keys | {key: value for key, value in stated.items() if value is not None}

    def _choose_rows(self, heights: Sequence[int], trained_height: int | None) -> int:
        """Return the rows [px] that the network is trained for; report images of far others."""
        rows = int(median(heights))
        far = [height for height in heights if not rows / 2 <= height <= 2 * rows]
        if far:
            text = f"{self.images}: {len(far)} of {len(heights)} images have more than twice or "
            text += f"less than half of the {rows} rows of the others, such as {far[0]}"
            if len(far) > len(heights) // 10:
                raise InputError(f"{text}: train on a folder of each size")
            tqdm.write(f"warning: {text}; all are resized to the same rows", file=sys.stderr)
        return network_size(None, (rows, rows), trained_height=trained_height)[0]


def _make_tables(
    classes: Sequence[Mapping[str, Any]],
    rows: int,
    keys: Mapping[str, Any],
    trained: Sequence[int],
    apart: Sequence[int],
) -> dict[str, Any]:
    """Return the tables of a recipe with the frames `apart` for validation."""

    def source(name: str, chosen: Sequence[int]) -> list[dict[str, Any]]:
        return [{"name": name, "kind": "folders", **keys, "parts": _list_parts(chosen)}]

    model = {"trained_height": rows} | ({"classes": classes} if classes else {})
    steps = min(max(_PASSES * len(trained) // _BATCH, _MIN_STEPS), _MAX_STEPS)
    tables: dict[str, Any] = {
        "model": model,
        "data": {"batch_size": _BATCH, "source": source("train", trained)},
        "schedule": {"steps": steps},
    }
    if apart:
        has_depth = "depth" in keys or "kind" in keys  # every second line is the input
        lidar = {"lidar": "own"} if has_depth else {}
        tables["validation"] = {**lidar, "source": source("val", apart)}
    return tables


def _choose_layers(network: Network, classes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the tables that say which layers are trained; those of other networks all are."""
    if not network.depth_layers:
        return {}
    if not classes:  # classes and boundaries stay as they are
        shared = [*network.shared_depth_layers]
        return {"optimizer": {"only": [*network.depth_layers], "frozen": shared}}
    is_known = all(info["of"] for info in classes)
    return {"optimizer": _CLASSES_ALONE} | ({"loop": _HALF_OF_START} if is_known else {})


def _list_parts(indices: Sequence[int]) -> list[list[int]]:
    """Return the first and the last of each run of neighbours."""
    held = {*indices}
    starts = [index for index in indices if index - 1 not in held]
    ends = [index for index in indices if index + 1 not in held]
    return [list(part) for part in zip(starts, ends, strict=True)]


def _choose_apart(names: Sequence[str], fold: int | None, folds: int) -> list[int]:
    """Return the frames that are kept apart, see `OwnFolders.make_recipe`."""
    if folds:
        return [] if fold is None else cut(names, folds)[fold]
    wanted = max(_LEAST_APART, len(names) // _VALIDATION)
    blocks = cut(names, max(_PLACES, len(names) * _PLACES // wanted))
    places = [blocks[(place + 1) * len(blocks) // _PLACES - 1] for place in range(_PLACES)]
    return [index for block in places for index in block]


def cut(names: Sequence[str], count: int) -> list[list[int]]:
    """Cut frames into so many blocks of neighbours, about equal, between places where these end.

    A place ends where the text of the names changes, or their number jumps, as stamps do.
    """
    parts = [re.fullmatch(r"(.*?)(\d*)", name) for name in names]
    texts = [found[1] if found else "" for found in parts]
    numbers = np.array([int((found and found[2]) or 0) for found in parts], dtype=np.float64)
    gaps = np.diff(numbers)
    far = gaps > _PLACE_GAP * max(1.0, float(np.median(gaps)))
    borders = [i + 1 for i, jump in enumerate(far) if jump or texts[i] != texts[i + 1]]
    size = len(names) / count
    cuts = [0]
    for block in range(1, count):
        wanted = round(block * size)
        near = [border for border in borders if abs(border - wanted) <= size / 2]
        nearest = min(near, key=lambda border: abs(border - wanted), default=wanted)
        cuts.append(max(nearest, cuts[-1] + 1))
    return [list(range(*ends)) for ends in itertools.pairwise([*cuts, len(names)])]


def _read_height(path: Path) -> int:
    """Return the rows of an image, by its header where that is near the start of the file."""
    with open_input(path, max_bytes=MAX_FILE_BYTES) as file:
        size = image_size(file.read(2**16))
    return size[0] if size else int(read_rgb(path).shape[0])


# Before each change of a recipe that is written with its changes.
_CHANGE = "# --set "


def write_toml(table: Mapping[str, Any], changes: Sequence[str], root: Path) -> str:
    """Return a recipe for the data in `root` as TOML, with its changes, which it lists."""
    lines = [f"# --data is {quoted(str(root))}."]
    source = table["data"]["source"][0]
    if "depth" in source and "intrinsics" not in source and source["kind"] == "folders":
        lines.append("# intrinsics = [721.5, 721.5, 609.6, 172.9] of a source: fx, fy, cx, cy [px]")
    lines += [_CHANGE + item for item in changes]
    return "\n".join((*lines, to_toml(change(table, changes)), ""))


def keep_recipe(table: Mapping[str, Any], changes: Sequence[str], root: Path, out: Path) -> None:
    """Write a recipe with its changes into a run's folder; InputError if the file was edited."""
    path = out / RECIPE_TEXT
    with folder_errors(out):
        if path.is_file():
            kept = read_text(path).splitlines()
            made = [line.removeprefix(_CHANGE) for line in kept if line.startswith(_CHANGE)]
            # Comments may name another place: data that were moved are the same data.
            if read_toml(path) != tomllib.loads(write_toml(table, made, root)):
                raise InputError(
                    f"{path}: is not the recipe that these folders give now: remove it, or train "
                    f"by it: ssdnet-train {path} --data DIR --init NAME --out RUN"
                )
            if (out / RECIPE).is_file():  # of the run that began by it
                return
        out.mkdir(parents=True, exist_ok=True)
        atomic_write(path, write_toml(table, changes, root).encode())
