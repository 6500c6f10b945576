"""The training loop: from a recipe to checkpoints."""

import copy
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from models import Network, save_checkpoint
from models.training_facts import TrainingFacts
from training.distributed import join_processes
from training.evaluation.score_set import Result
from training.initial_weights import Weights
from training.loading.batches import read_batches
from training.recipe import Recipe
from training.release import adjust_logits
from training.run_folder import (
    BEST,
    FINAL,
    LAST,
    PAGE,
    SCORES,
    TENSORBOARD,
    list_data,
    lock_folder,
    prepare_folder,
)
from training.score_table import ScoreTable
from training.state import TrainingState
from training.stop_signal import StopRequested
from training.task import open_task
from training.validation import Board, validate, write_validation


def train(
    recipe: Recipe,
    *,
    data: Sequence[Path],
    out: Path,
    init: Weights | None = None,
    teacher: Weights | None = None,
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Path:
    """Train a network by a recipe.

    Writes to `out`: recipe.json (resolved), last.pt (to resume from), model.pt (the averaged
    weights, to release), best.pt (those of the best validation so far), scores.csv (every score of
    every validation), validation.html (the page of the last one) and tensorboard/. An `out`
    with a last.pt of the same recipe is resumed. Started by torchrun, each process takes its share
    of every batch, see `training.distributed`; the first one writes, and all stop at the same step.

    Args:
        recipe: what to train and how.
        data: folders with the recipe's data sets.
        out: folder of the run.
        init: a checkpoint to start from; weights that do not fit are initialised as usual.
        teacher: a checkpoint whose answers are learned, too, see `training.losses.distillation`.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step; the run can be resumed.
        stop: called between two steps, and between two frames of the survey and of a validation;
            True stops the run, which can be resumed.

    Returns:
        model.pt, or last.pt if the run was stopped; last.pt does not exist before the first step.

    Raises:
        InputError: if the recipe, the device or `out` cannot be used, for example an `out` of
            another recipe.
        DatasetError: if a data set is missing or damaged.
        CheckpointError: if nothing of `init` fits, or a checkpoint cannot be read or written.
        NonFiniteLossError: if the loss or its gradient is NaN or infinite.
    """
    with join_processes(device) as processes, ExitStack() as held, suppress(StopRequested):
        resumed = (out / LAST).is_file()
        # Several processes stop together, at a step: none may leave the others in the survey.
        alone = stop if processes.count == 1 else (lambda: False)
        task = open_task(recipe, processes, data, init, teacher, resumed=resumed, stop=alone)
        resolved: dict[str, Any] = {
            "recipe": asdict(recipe),
            "crop": task.data.augment.crop,
            "init": None if init is None else init.name,
            "teacher": None if teacher is None else teacher.name,
            "processes": processes.count,
        }
        if processes.is_first:
            # Made last: a training that cannot start leaves no folder.
            held.enter_context(lock_folder(out))
            sets = (*recipe.data.source, *recipe.validation.source)
            files = list_data(data, [folder for item in sets for folder in item.folders])
            prepare_folder(out, resolved, files, data)
        processes.wait()
        state = TrainingState(recipe, task, processes, out)
        state.resume(out / LAST)
        steps = recipe.schedule.steps
        if state.step == steps and (out / FINAL).is_file():
            if processes.is_first:
                tqdm.write(f"all {steps} steps of {out} are done", file=sys.stderr)
            return out / FINAL
        if state.step and processes.is_first:
            tqdm.write(f"resumed at step {state.step} of {steps}", file=sys.stderr)

        def facts() -> dict[str, Any]:
            return TrainingFacts(
                data=task.known_data,
                terms=task.data_terms,
                trained_height=recipe.model.trained_height,
                step=state.step,
                **resolved,
            ).to_dict()

        def released() -> Network:
            share = recipe.release.logit_adjustment
            return adjust_logits(state.averaged, task.criterion.class_weights, share)

        scores = ScoreTable(out / SCORES, state.step) if processes.is_first else None
        results: dict[str, Sequence[Result]] = {}  # of the last validation, and of that before
        last_step = steps if stop_after is None else min(steps, stop_after)
        with (
            Board(out / TENSORBOARD if processes.is_first else None, state.step) as board,
            tqdm(
                total=steps,
                initial=state.step,
                desc="train",
                unit="step",
                mininterval=1.0 if sys.stderr.isatty() else 30.0,  # a line of a log file
                disable=not processes.is_first,
            ) as bar,
            read_batches(recipe, task, processes, state.step) as batches,
        ):

            def score(name: str, network: Network) -> None:
                """Validate; the first process alone writes the table and the best weights."""
                results[name] = validate(
                    name,
                    network,
                    recipe.model.class_table,
                    task,
                    processes,
                    board,
                    state.step,
                    pictures=recipe.validation.pictures,
                    stop=stop,
                )
                figures = {result.row.data: result.row.figures for result in results[name]}
                if scores and scores.add(state.step, figures, recipe.validation.best):
                    save_checkpoint(out / BEST, network, training=facts())

            def is_due() -> bool:
                last = state.step == steps
                return bool(task.validation) and (last or state.step % recipe.validate_every == 0)

            if state.step == 0 and task.validation and init is not None:
                score("before", state.averaged)
            elif state.step and is_due():
                # A run that was stopped or killed in a validation begins with it.
                known = scores is not None and state.step in scores
                if not any(processes.gather(known)):
                    score("after", released())
            while state.step < last_step and not processes.any_of(stop()):
                done = state.advance(batches)
                if bar.update():  # the loss is read from its device only when it is shown
                    bar.set_postfix(loss=f"{done.terms['total'].item():.3f}", refresh=False)
                if state.step % recipe.log_every == 0:
                    board.add_step(done, dict(state.criterion.log_variances.items()), state.step)
                # Before the validation, which takes long and may be ended by a kill.
                if is_due() or state.step % recipe.checkpoint_every == 0:
                    state.save(out / LAST, facts())
                if is_due():
                    score("after", released())
        state.save(out / LAST, facts())
        if state.step == steps and processes.is_first:
            save_checkpoint(out / FINAL, released(), training=facts())
            for line in scores.compare() if scores else ():
                tqdm.write(line, file=sys.stderr)
            if task.validation:
                networks = {"after": released()}
                classes = networks["after"].config.classes
                if init is not None and init.network.config.classes == classes:
                    before = copy.deepcopy(init.network).to(processes.device)
                    networks = {"before": before, **networks}
                    if before.config != networks["after"].config:
                        results.pop("before", None)  # it was another network's
                table = recipe.model.class_table
                write_validation(networks, table, task, out / PAGE, known=results, stop=stop)
        processes.wait()  # until the file is written
        # A run that was stopped early releases no weights.
        return out / (FINAL if state.step == steps else LAST)
    return out / LAST
