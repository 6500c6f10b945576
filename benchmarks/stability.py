"""How much the depth changes when the image is cut by a few columns.

    python benchmarks/stability.py MODEL [MODEL ...] --data DIR

MODEL is a bundled name, an exported file or a checkpoint with semantic and depth. In the validation
frames of DIR/kitti_streets, with all 64 lines and at the frames' own size, 1 to 8 columns are cut
off the left of image and depth map. The program prints the share of pixels whose depth changes by
more than 5 %. Only pixels farther than 6 px from a return are counted, without sky and without the
left 32 columns of the cut frame.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from runtime.contract.contract import find_sky
from runtime.engine.bundled_models import find_model
from training.datasets.class_mapping import list_classes
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.sample import Sample
from training.evaluation.open_model import open_scored_model
from training.loading.open_dataset import open_dataset
from training.scores.depth_regions import distance_px
from training.scores.evaluated_set import short_names
from training.scores.scoring import Predict

STREETS = KittiStreetsRecipe(path="kitti_streets", first=70, last=98)
CUT_COLUMNS = (1, 2, 3, 5, 8)
SKIPPED_COLUMNS = 32
NEAR_RETURN_PX = 6
CHANGE = 0.05


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", metavar="MODEL")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    source = open_dataset(STREETS, [arguments.data], classes="camvid")
    paths = [Path(name) if name.endswith(".pt") else find_model(name) for name in arguments.models]
    print("| model | changed depth % |\n|---|---|")
    for title, path in zip(short_names(paths), paths, strict=True):
        with open_scored_model(path, threads=arguments.threads, size="frame") as model:
            frames = (source[index] for index in range(len(source)))
            changed = changed_share(model.predict, frames, sky=find_sky(list_classes(model.table)))
            print(f"| {title} | {100 * changed:.1f} |", flush=True)


def changed_share(predict: Predict, frames: Iterable[Sample], *, sky: int | None) -> float:
    """Return the share of the compared pixels whose depth changes, see the module's docstring."""
    changed = compared = 0
    for frame in frames:
        assert frame.returns is not None
        whole = predict(frame.rgb, frame.returns, frame.focal_length_px)
        assert whole.depth is not None
        counted = distance_px(frame.returns > 0) > NEAR_RETURN_PX
        if sky is not None:
            counted &= whole.semantic != sky
        for columns in CUT_COLUMNS:
            cut = predict(
                np.ascontiguousarray(frame.rgb[:, columns:]),
                np.ascontiguousarray(frame.returns[:, columns:]),
                frame.focal_length_px,
            )
            assert cut.depth is not None
            before, after = np.s_[:, columns + SKIPPED_COLUMNS :], np.s_[:, SKIPPED_COLUMNS:]
            ratio = cut.depth[after] / whole.depth[before]
            changed += np.count_nonzero(np.abs(ratio - 1)[counted[before]] > CHANGE)
            compared += np.count_nonzero(counted[before])
    return changed / compared


if __name__ == "__main__":
    main()
