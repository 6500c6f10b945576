"""Open the data sets of a recipe, and count what their frames hold."""

import hashlib
import os
import pickle
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from models import NetworkConfig
from runtime.base.errors import DatasetError
from runtime.contract.network_size import network_size
from runtime.files.read_input import open_input
from training.base.own_code import named_errors
from training.base.stop_signal import Stop, StopRequested, never
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import ChangedSource, Sample, SampleSource, labelled, target_kind
from training.datasets.source_recipe import SourceRecipe
from training.loading.geometric import resize

# Number of frames from which the class frequencies of the loss are counted.
FREQUENCY_SAMPLES = 400
# Least number of frames of the training on which pruning is based.
_PICTURES = 32
# A share of a set's depth beyond the network's range that is at least this large is reported.
_FAR_SHARE = 0.1
# Least focal length as a share of the image's side; a view of 157 degrees. Fisheye lenses have 0.3.
_SHORTEST = 0.1


class CheckedSource(ChangedSource):
    """A data set whose targets have their type and size, and its cameras fit their images.

    The frames are resized to the recipe's size with `training.loading.geometric.resize`, if it has
    one. A DatasetError about a frame names the reader and the frame.
    """

    def __init__(self, source: SampleSource, recipe: SourceRecipe) -> None:
        super().__init__(source)
        self._recipe = recipe

    def __getitem__(self, index: int) -> Sample:
        with named_errors(f"{self._recipe.title}: the reader of frame {index}"):
            sample = self._source[index]
        if self._recipe.states_camera:
            _require_camera(sample)
        for target in sample.known:
            values, kind = sample.target(target), target_kind(target)
            if values.dtype != kind.dtype or values.shape != sample.size:
                raise DatasetError(
                    f"{sample.name}: the reader {type(self._source).__name__} returned {target} = "
                    f"{values.dtype} {values.shape}; expected {kind.dtype} {sample.size}, "
                    f"{kind.unlabelled:g} = unknown; a set without this target must omit it"
                )
        size = network_size(self._recipe.size or "frame", sample.size, trained_height=None)
        return resize(sample, size)


def _require_camera(sample: Sample) -> None:
    """Raise DatasetError for intrinsics that cannot be those of an image of this size."""
    if sample.intrinsics is None:
        return
    (fx, _, cx), (_, fy, cy), _ = sample.intrinsics
    height, width = sample.size
    shape = f"its image of {width} x {height} px (width x height)"
    if not (-0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5):
        raise DatasetError(
            f"{sample.name}: the principal point ({cx:.5g}, {cy:.5g}) is outside of {shape}: "
            "the intrinsics are those of another size: multiply all four by the ratio of the sizes"
        )
    if fx < _SHORTEST * width or fy < _SHORTEST * height:
        raise DatasetError(
            f"{sample.name}: the focal length of {min(fx, fy):.3g} px is too short for {shape}: "
            "give it in pixels: millimetres times the width in pixels by that of the sensor"
        )


class Watched(ChangedSource):
    """A data set that raises StopRequested instead of a frame once `stop` is True."""

    def __init__(self, source: SampleSource, stop: Stop) -> None:
        super().__init__(source)
        self._stop = stop

    def __getitem__(self, index: int) -> Sample:
        if self._stop():
            raise StopRequested
        return self._source[index]


class HeldSource:
    """The frames of a stream, such as a bag, which are read once in their order and held packed.

    Training draws frames in another order, in several processes.
    """

    def __init__(self, source: SampleSource) -> None:
        self.images: Sequence[Path] = ()
        self.digests: list[bytes] = []  # of the images
        self._packed: list[bytes] = []
        for index in range(len(source)):
            sample = source[index]
            self.digests.append(hashlib.sha256(sample.rgb.tobytes()).digest())
            self._packed.append(zlib.compress(pickle.dumps(sample), level=1))

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: int) -> Sample:
        sample: Sample = pickle.loads(zlib.decompress(self._packed[index]))
        return sample


def open_dataset(
    recipe: SourceRecipe, roots: Sequence[Path], *, classes: ClassTable, stop: Stop = never
) -> SampleSource:
    """Open a data set in the first of `roots` that has its folder.

    `classes` is the table of the class ids. Raises DatasetError if there is no such folder, or if
    it cannot be read, and StopRequested once `stop` is True while a stream is read.
    """
    path = _find_path(recipe, roots)
    with named_errors(f"{recipe.title}: the reader"):
        source = recipe.open(path, classes)
    checked = CheckedSource(source, recipe)
    return HeldSource(Watched(checked, stop)) if getattr(source, "is_stream", False) else checked


def _find_path(recipe: SourceRecipe, roots: Sequence[Path]) -> Path:
    for root in roots:
        path = root / recipe.path
        if path.is_dir() or (recipe.may_be_file and path.is_file()):
            return path
    below = (
        "" if Path(recipe.path).is_absolute() else f" in {', '.join(map(repr, map(str, roots)))}"
    )
    what = "recording" if recipe.may_be_file else "folder"
    raise DatasetError(
        f"no {what} {recipe.path!r} ({recipe.kind}){below}: name the folder that holds it with "
        "--data"
    )


def frame_files(sources: Iterable[SampleSource]) -> dict[tuple[int, int], Path]:
    """Return the file of each frame's image by device and number, the same by any path or link."""
    found: dict[tuple[int, int], Path] = {}
    for source in sources:
        for path in getattr(source, "images", ()):
            with open_input(path, max_bytes=None) as file:  # a link may lead nowhere
                item = os.fstat(file.fileno())
            found.setdefault((item.st_dev, item.st_ino), path)
    return found


def _digests(sources: Iterable[SampleSource]) -> list[bytes]:
    """Return the digests of the images of sets without files."""
    return [digest for source in sources for digest in getattr(source, "digests", ())]


def count_frames(sources: Sequence[SampleSource]) -> int:
    """Return the number of different images."""
    return len(frame_files(sources)) + len(set(_digests(sources)))


def count_shared(sources: Sequence[SampleSource], others: Sequence[SampleSource]) -> int:
    """Return how many images of some sets are also in others: the same file, or a copy of it.

    Files of one size, and the images of streams, are compared by their SHA-256.
    """
    held = set(_digests(others))
    here, there = frame_files(sources), frame_files(others)
    sizes: dict[int, list[Path]] = {}
    for path in there.values():
        sizes.setdefault(path.stat().st_size, []).append(path)

    @cache
    def digests(size: int) -> set[bytes]:
        return {_digest(path) for path in sizes[size]}

    count = sum(digest in held for digest in _digests(sources))
    for key, path in here.items():
        size = path.stat().st_size
        count += key in there or (size in sizes and _digest(path) in digests(size))
    return count


def _digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def spread_indices(source: SampleSource, count: int) -> list[int]:
    """Return `count` indices at equal distances, or all of a smaller set."""
    indices: list[int] = (
        np.linspace(0, len(source) - 1, min(count, len(source))).astype(int).tolist()
    )
    return indices


def spread_pictures(sources: Sequence[SampleSource]) -> Iterator[Tensor]:
    """Yield the images of frames of all sets, each float (1, 3, H, W), RGB in 0..255."""
    for source in sources:
        for index in spread_indices(source, -(-_PICTURES // len(sources))):
            yield torch.from_numpy(source[index].rgb).permute(2, 0, 1)[None].float()


class Survey(NamedTuple):
    """Counts of about `FREQUENCY_SAMPLES` frames without augmentation, by the sets' weights.

    Attributes:
        smallest: the least height and the least width of the frames that were read.
        classes: pixels of each class, in millionths of a frame; labels that a network made count by
            their weight.
        targets: targets for which a frame has labels that are trained.
        notes: for each target, the labels that are not trained, in words.
    """

    smallest: tuple[int, int]
    classes: NDArray[np.float64]
    targets: Collection[str]
    notes: Sequence[tuple[str, str]]


def survey(
    recipes: Sequence[SourceRecipe],
    sources: Sequence[SampleSource],
    class_names: Sequence[str],
    config: NetworkConfig,
) -> Survey:
    """Count what sets hold for a network; `class_names` are those of their ids."""
    counts, sizes = np.zeros(len(class_names)), list[tuple[int, int]]()
    targets: set[str] = set()
    notes: list[tuple[str, str]] = []
    total = sum(item.weight for item in recipes)
    for item, source in zip(recipes, sources, strict=True):
        wanted = max(1, round(FREQUENCY_SAMPLES * item.weight / total))
        frames = spread_indices(source, wanted)
        empty: Counter[str] = Counter()
        near = known = within = 0  # pixels of depth: learned, all, in the range of returns
        for index in frames:
            sample = source[index]
            sizes.append(sample.size)
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[: len(class_names)]
            weight = sample.weights.get("semantic", 1.0) * wanted / len(frames)
            counts += seen * weight / sample.semantic.size
            learned = {name: _count_learned(sample, name, config) for name in sample.known}
            targets |= {name for name, count in learned.items() if count}
            empty.update(name for name, count in learned.items() if not count)
            near += learned.get("depth", 0)
            known += int((sample.depth > 0).sum())
            scale = _canonical_scale(sample, config)
            within += int(((sample.depth > 0) & (sample.depth <= scale * config.max_depth_m)).sum())
        for target, number in empty.items():
            text = f"{number} of {len(frames)} frames of {item.title} have no {target}"
            notes.append((target, f"{text} to learn from"))
        if known - near > _FAR_SHARE * known:
            text = f"{item.title}: {1 - near / known:.0%} of the depth is beyond "
            text += f"{scale * config.unmeasured_range_m:.3g} m and not trained"
            if within - near > _FAR_SHARE * known:
                text += f": set model.config.farthest_guess_m = {config.max_depth_m:g} to train it"
                text += ", or check the focal length" * (scale != 1)
                notes.append(("depth", text))
            elif item.unit_key:
                text += f": check the unit ({item.unit_key}: units per metre, 1000 for millimetres)"
                text += ", or the focal length in pixels" * bool(sample.focal_length_px)
                notes.append(("depth", text))
    counts = np.round(counts * 1_000_000)
    unlabelled = [name for name, count in zip(class_names, counts, strict=True) if not count]
    if unlabelled:
        text = f"is labelled {', '.join(unlabelled)}: such a class is not trained"
        if len(unlabelled) == len(class_names):
            text = "is labelled: classes and boundaries are not trained"
        titles = ", ".join(item.title for item in recipes)
        notes.append(("semantic", f"no pixel of {len(sizes)} frames of {titles} {text}"))
    height, width = np.min(sizes, axis=0).tolist()
    return Survey((height, width), counts, targets, notes)


def _count_learned(sample: Sample, target: str, config: NetworkConfig) -> int:
    """Return the number of a frame's labels of a target that count in the loss."""
    if not sample.weights.get(target, 1.0) > 0:
        return 0
    known = labelled(target, sample.target(target))
    if target == "depth":
        known &= sample.depth <= _canonical_scale(sample, config) * config.unmeasured_range_m
    return int(known.sum())


def _canonical_scale(sample: Sample, config: NetworkConfig) -> float:
    """Return the metres of a frame in a canonical metre of the network."""
    canonical, focal = config.canonical_focal_px, sample.focal_length_px
    return focal / canonical if canonical and focal else 1.0
