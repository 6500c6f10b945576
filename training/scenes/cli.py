"""`ssdnet-render`: render driving scenes into the Virtual KITTI 2 layout."""

import signal
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing import TimeoutError, get_context
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from runtime.command.options import Version
from runtime.command.process import leave_signals_to_parent, reported_errors, stop_requested
from runtime.contract.contract import MIN_SIDE
from training.scenes.names import CameraName, StreetKind, Variant

if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized

    from training.scenes.scene_job import SceneJob

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)

# Frames of the drive in a second, and seconds until the ego car reaches the end of the street.
_FRAMES_PER_S, _LONGEST_S = 10.0, 16.0
# Seconds between two looks at the frames that processes have rendered.
_BAR_S = 0.5
# In a process: the number of frames that all of them have rendered.
_done: "Synchronized[int]"


@app.command()
def render(
    out: Annotated[Path, typer.Argument(help="Folder of the scenes.")],
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 10,
    frames: Annotated[int, typer.Option(min=1, help="Frames of each scene.")] = 4,
    variant: Annotated[
        list[Variant] | None,
        typer.Option(help="Light of the scenes, which take turns. May be repeated. [default: all]"),
    ] = None,
    size: Annotated[
        str, typer.Option(help="HEIGHTxWIDTH in pixels; varied cameras ignore it.")
    ] = "375x1242",
    camera: Annotated[
        CameraName,
        typer.Option(help="KITTI's field of view, or a random one and a random size per scene."),
    ] = CameraName.kitti,
    street: Annotated[
        StreetKind | None, typer.Option(help="Kind of street. [default: random]")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first scene.")] = 0,
    stride: Annotated[
        int,
        typer.Option(min=1, help="Render every n-th frame of the drive, which has 10 a second."),
    ] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    overwrite: Annotated[bool, typer.Option(help="Replace existing scenes.")] = False,
    _version: Version = False,
) -> None:
    """Render street scenes: the image, depth, classes and a LiDAR scan of every frame."""
    step_s = stride / _FRAMES_PER_S
    if (frames - 1) * step_s > _LONGEST_S:
        raise typer.BadParameter(
            f"a street lasts {_LONGEST_S:.0f} s, not {(frames - 1) * step_s:.1f}: "
            "ask for fewer frames or a smaller stride",
            param_hint="--frames",
        )
    height, _, width = size.partition("x")
    if not (height.isdigit() and width.isdigit() and min(int(height), int(width)) >= MIN_SIDE):
        raise typer.BadParameter(
            f"{size!r} is not HEIGHTxWIDTH of {MIN_SIDE} pixels or more", param_hint="--size"
        )
    variants, pixels = variant or list(Variant), (int(height), int(width))
    with reported_errors("train"):
        from training.scenes.scene_job import SceneJob, run_job
    jobs = [
        SceneJob(seed + k, variants[k % len(variants)], frames, step_s, pixels, camera, kind=street)
        for k in range(scenes)
    ]
    with reported_errors("train"), stop_requested(interrupts=True), ExitStack() as stack:
        from tqdm import tqdm

        # None shows no bar without a terminal.
        bar = stack.enter_context(tqdm(total=scenes * frames, unit="frame", disable=None))
        if workers == 1:
            total = sum(
                run_job(job, out=out, overwrite=overwrite, advance=bar.update) for job in jobs
            )
        else:
            context = get_context("spawn")
            done, total = context.Value("q", 0), 0
            pool = stack.enter_context(context.Pool(workers, _begin_worker, [done]))
            counts = pool.imap_unordered(partial(_run_job, out=out, overwrite=overwrite), jobs)
            while total < bar.total:
                with suppress(TimeoutError):
                    total += counts.next(_BAR_S)
                bar.update(done.value - bar.n)
    typer.echo(f"{total} frames of {scenes} scenes in {out}")


def _begin_worker(done: "Synchronized[int]") -> None:
    global _done
    _done = done
    leave_signals_to_parent()
    # The pool ends its processes by SIGTERM, and waits for those that ignore it.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _run_job(job: "SceneJob", *, out: Path, overwrite: bool) -> int:
    """Run a job in a process, and count its frames for the parent's bar."""
    from training.scenes.scene_job import run_job

    def advance() -> None:
        with _done.get_lock():
            _done.value += 1

    return run_job(job, out=out, overwrite=overwrite, advance=advance)
