"""Teaches a fused start of the encoder the features of EfficientNet-Lite0, for --init of a recipe.

    python benchmarks/fused_start.py open --data DIR --out START.pt [--steps 3000] [--threads 1]

No labels are read: the images are those of the recipe's first stage, with its changes of colours,
and the weights are those that it would begin with, but for the start. It prints the squared error
of the features at strides 2 and 4, as a share of their variance.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from models import create_model, save_checkpoint
from models.efficientnet_lite import CHANNELS, EfficientNetLite
from training.loading.augment_config import AugmentConfig
from training.loading.colors import change_colors
from training.loading.mixture import CachedSource
from training.loading.open_dataset import open_dataset
from training.recipes.registry import RECIPES
from training.run.provenance import state_provenance
from training.weights.imagenet_weights import COLORS, load_imagenet

CROP, SCALE, BATCH = (192, 256), (0.7, 1.5), 6
RATE = 4e-3
# The layers that learn.
START = ("stem", "stride2", "stride4")


def main() -> None:
    """Parse the command line, learn, and write the checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recipe", choices=RECIPES)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    recipe = RECIPES[arguments.recipe].stages[0].recipe
    classes = recipe.model.class_table
    sets = [open_dataset(item, [arguments.data], classes=classes) for item in recipe.data.source]
    sources = [CachedSource(each, limit_bytes=2**29) for each in sets]
    shares = np.array([item.weight for item in recipe.data.source])
    pictures = crops(sources, shares / shares.sum(), recipe.data.augment)
    network = create_model(recipe.model.name, **{**recipe.model.config, **COLORS})
    teacher = EfficientNetLite()
    load_imagenet(teacher)
    learn_start(network.encoder, teacher.eval(), pictures, arguments.steps, network.normalise_rgb)
    late = {k: v for k, v in teacher.state_dict().items() if not k.startswith(START)}
    network.encoder.load_state_dict({**network.encoder.state_dict(), **late})
    data, terms = state_provenance(recipe)
    save_checkpoint(arguments.out, network.eval(), training={"data": list(data), "terms": terms})


def crops(
    sources: list[CachedSource], shares: NDArray[np.float64], augment: AugmentConfig
) -> Iterator[Tensor]:
    """Yield batches of random crops, float (BATCH, 3, *CROP), RGB in 0..255."""
    rng = np.random.default_rng(0)
    height, width = CROP
    while True:
        batch = []
        for _ in range(BATCH):
            source = sources[rng.choice(len(sources), p=shares)]
            rgb = source[int(rng.integers(len(source)))].rgb
            scale = rng.uniform(*SCALE)
            rows, columns = int(height / scale), int(width / scale)
            top = int(rng.integers(max(1, rgb.shape[0] - rows)))
            left = int(rng.integers(max(1, rgb.shape[1] - columns)))
            crop = rgb[top : top + rows, left : left + columns]
            if rng.random() < augment.flip:
                crop = crop[:, ::-1]
            crop = cv2.resize(np.ascontiguousarray(crop), (width, height))
            batch.append(torch.from_numpy(change_colors(crop, augment, rng)).permute(2, 0, 1))
        yield torch.stack(batch).float()


def learn_start(
    student: EfficientNetLite,
    teacher: EfficientNetLite,
    pictures: Iterator[Tensor],
    steps: int,
    normalise: Callable[[Tensor], Tensor],
) -> None:
    """Train the start of `student` to have the features of `teacher` at strides 2 and 4.

    At stride 2 a linear map of the features is compared: what reads them is trained later.
    """
    skip = nn.Conv2d(CHANNELS[2], CHANNELS[2], 1)
    early = [p for name in START for p in getattr(student, name).parameters()]
    optimizer = torch.optim.AdamW([*early, *skip.parameters()], RATE, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, RATE, total_steps=steps, pct_start=0.1
    )
    student.train()
    mean = np.zeros(2)
    for step, rgb in zip(range(1, steps + 1), pictures, strict=False):
        images = normalise(rgb)
        with torch.no_grad():
            wanted = teacher.early(images)
        at_2, at_4 = student.early(images)
        errors = torch.stack([unexplained(skip(at_2), wanted[0]), unexplained(at_4, wanted[1])])
        optimizer.zero_grad()
        (0.5 * errors[0] + errors[1]).backward()
        optimizer.step()
        schedule.step()
        mean += max(0.02, 1 / step) * (errors.detach().numpy() - mean)
        if step % 250 == 0 or step == steps:
            print(f"{step} steps: stride 2 {mean[0]:.3f}, stride 4 {mean[1]:.3f}", flush=True)


def unexplained(features: Tensor, wanted: Tensor) -> Tensor:
    """Return the squared error as a share of each channel's variance, a mean over them."""
    dims = (0, 2, 3)
    return ((features - wanted).square().mean(dims) / (wanted.var(dims) + 1e-3)).mean()


if __name__ == "__main__":
    main()
