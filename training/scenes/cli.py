"""`ssdnet-render`: render driving scenes into the Virtual KITTI 2 layout."""

import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from runtime.command import interruptible, reported_errors
from runtime.command_options import Version
from runtime.contract import MIN_SIDE

if TYPE_CHECKING:
    from multiprocessing.pool import Pool

app = typer.Typer(pretty_exceptions_enable=False)

T = TypeVar("T")


@app.command()
def render(
    out: Annotated[Path, typer.Argument(help="Folder of the scenes.")],
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 10,
    frames: Annotated[int, typer.Option(min=1, help="Frames of each scene and variant.")] = 4,
    variants: Annotated[
        str, typer.Option(help="Comma-separated: clone, morning, sunset, overcast, fog, rain.")
    ] = "clone,morning,sunset,overcast,fog,rain",
    every_variant: Annotated[
        bool,
        typer.Option(
            help="Render each scene in every variant instead of one variant per scene, in turn."
        ),
    ] = False,
    size: Annotated[
        str, typer.Option(help="HEIGHTxWIDTH in pixels; ignored by varied cameras.")
    ] = "375x1242",
    camera: Annotated[
        str,
        typer.Option(
            help="Field of view: kitti, camvid, or varied (random field of view and size per "
            "scene)."
        ),
    ] = "kitti",
    street: Annotated[
        str, typer.Option(help="town, residential, avenue, highway or square; random by default.")
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    fps: Annotated[float, typer.Option(min=0.1, help="Frame rate of the simulated drive.")] = 10.0,
    stride: Annotated[int, typer.Option(min=1, help="Render every n-th frame of the drive.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    overwrite: Annotated[bool, typer.Option(help="Replace existing scenes.")] = False,
    _version: Version = False,
) -> None:
    """Render street scenes: RGB, depth and classes of every frame."""
    with reported_errors("train"):
        from training.scenes.layout.street_plan import STREET_KINDS, StreetKind
        from training.scenes.rendering.camera import CameraName
        from training.scenes.rendering.weather import VARIANTS, Variant
        from training.scenes.scene_job import LONGEST_S, SceneJob

    cameras: dict[str, CameraName] = {"kitti": "kitti", "camvid": "camvid", "varied": "varied"}
    kinds: dict[str, StreetKind] = {kind: kind for kind in STREET_KINDS}
    known: dict[str, Variant] = {variant: variant for variant in VARIANTS}
    wanted = _split(variants, known, "--variants")
    step_s = stride / fps
    if (frames - 1) * step_s > LONGEST_S:
        raise typer.BadParameter(
            f"a street lasts {LONGEST_S:.0f} s, not {(frames - 1) * step_s:.1f}; "
            "ask for fewer frames or a smaller stride",
            param_hint="--frames",
        )
    jobs = [
        SceneJob(
            root=out,
            seed=seed + index,
            variants=wanted if every_variant else (wanted[index % len(wanted)],),
            frames=frames,
            step_s=step_s,
            camera=_split(camera, cameras, "--camera")[0],
            size=_parse_size(size),
            kind=_split(street, kinds, "--street")[0] if street else None,
            overwrite=overwrite,
        )
        for index in range(scenes)
    ]
    with reported_errors("train"), interruptible():
        total = _run(jobs, workers)
    typer.echo(f"{total} frames of {scenes} scenes in {out}")


def _split(text: str, known: "dict[str, T]", option: str) -> "tuple[T, ...]":
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise typer.BadParameter(
            f"{', '.join(unknown) or 'nothing'} is not among {', '.join(known)}", param_hint=option
        )
    return tuple(known[name] for name in names)


def _parse_size(text: str) -> tuple[int, int]:
    height, _, width = text.partition("x")
    if not (height.isdigit() and width.isdigit() and min(int(height), int(width)) >= MIN_SIDE):
        raise typer.BadParameter(
            f"{text!r} is not HEIGHTxWIDTH of {MIN_SIDE} pixels or more", param_hint="--size"
        )
    return int(height), int(width)


def _run(jobs: list, workers: int) -> int:  # type: ignore[type-arg]
    from tqdm import tqdm

    from training.scenes.scene_job import run_job

    with ExitStack() as stack:
        run = map if workers == 1 else stack.enter_context(_start_pool(workers)).imap_unordered
        # None: no bar without a terminal.
        return sum(tqdm(run(run_job, jobs), total=len(jobs), unit="scene", disable=None))


def _start_pool(workers: int) -> "Pool":
    """Start processes that ignore Ctrl-C; the parent terminates them."""
    from multiprocessing import get_context

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # is inherited
    try:
        return get_context("spawn").Pool(workers)
    finally:
        signal.signal(signal.SIGINT, before)
