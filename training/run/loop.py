"""The training loop: from a recipe to checkpoints."""

import copy
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from typing import Any

from tqdm import tqdm

from models import Network, save_checkpoint
from models.checkpoint import BEST, FINAL, LAST
from models.training_facts import TrainingFacts
from training.base.processes import join_processes
from training.base.stop_signal import StopRequested
from training.loading.batch import Batch
from training.run import run_folder
from training.run.batches import read_batches
from training.run.provenance import state_provenance
from training.run.recipe import Recipe
from training.run.score_table import ScoreTable
from training.run.state import TrainingState
from training.run.task import Task, open_task
from training.run.training_run import RunResult, TrainingRun
from training.run.validation import Board, validate, write_validation
from training.scores.score_set import Result
from training.weights.release import adjust_logits


def train(recipe: Recipe, run: TrainingRun) -> RunResult:
    """Train a network by a recipe.

    Writes to `run.out`: recipe.json (resolved), last.pt (to resume from), model.pt (the averaged
    weights, to release), best.pt (those of the best validation so far), scores.csv (every score of
    every validation), validation.html (the page of the last one) and tensorboard/. A folder with a
    last.pt of the same recipe is resumed. Started by torchrun, each process takes its share of
    every batch, see `training.base.processes`; the first one writes, and all stop at the same
    step.

    Args:
        recipe: what to train and how.
        run: on which data, from which weights, to which folder, and how far. Initial weights that
            do not fit are initialised as usual.

    Returns:
        The model.pt, or the last.pt of a run that was stopped.

    Raises:
        InputError: if the recipe, the device or the folder cannot be used, for example a folder of
            another recipe.
        DatasetError: if a data set is missing or damaged.
        CheckpointError: if nothing of `run.init` fits, or a checkpoint cannot be read or written.
        NonFiniteLossError: if the loss or its gradient is NaN or infinite.
    """
    final = RunResult(run.out / FINAL)
    stopped = RunResult(run.out / LAST, stopped=True)
    with join_processes(run.device) as processes, ExitStack() as held, suppress(StopRequested):
        task = open_task(recipe, run, processes, resumed=stopped.path.is_file())
        resolved = {
            "recipe": asdict(recipe),
            "crop": task.data.augment.crop,
            "init": None if run.init is None else run.init.name,
            "teacher": None if run.teacher is None else run.teacher.name,
            "processes": processes.count,
        }
        if processes.is_first:
            # Made last: a training that cannot start leaves no folder.
            held.enter_context(run_folder.lock_folder(run.out))
            sets = (*recipe.data.source, *recipe.validation.source)
            files = run_folder.list_data(
                run.data, [folder for item in sets for folder in item.folders]
            )
            run_folder.prepare_folder(run.out, resolved, files, run.data)
        processes.wait()
        loop = _Loop(task, resolved)
        loop.state.resume(stopped.path)
        if loop.is_complete and final.path.is_file():
            loop.tell(f"all {loop.steps} steps of {run.out} are done")
            return final
        if loop.state.step:
            loop.tell(f"resumed at step {loop.state.step} of {loop.steps}")
        loop.advance()
        loop.save()
        if loop.is_complete and processes.is_first:
            loop.release()
            loop.tell(f"curves and pictures: tensorboard --logdir {shlex.quote(str(run.out))}")
        processes.wait()  # until the file is written
        # A run that was stopped early releases no weights.
        return final if loop.is_complete else stopped
    return stopped


class _Loop:
    """A training in one of its processes: its steps, and what is written between them."""

    def __init__(self, task: Task, resolved: Mapping[str, Any]) -> None:
        self._recipe, self._run, self._processes = task.recipe, task.run, task.processes
        self._task, self.state = task, TrainingState(task)
        self.steps = task.recipe.schedule.steps
        self._resolved = resolved
        self._scores: ScoreTable  # written by the first process alone
        # Of the last validation ("after"), and of that before the first step.
        self._results: dict[str, Sequence[Result]] = {}

    @property
    def is_complete(self) -> bool:
        """Whether all steps are done."""
        return self.state.step == self.steps

    def tell(self, text: str) -> None:
        """Print a line above the progress bar; the first process does."""
        if self._processes.is_first:
            tqdm.write(text, file=sys.stderr)

    def save(self) -> None:
        """Write last.pt."""
        self.state.save(self._run.out / LAST, self._facts())

    def advance(self) -> None:
        """Take the steps that are left, with their checkpoints and validations."""
        first, is_first = self.state.step, self._processes.is_first
        self._scores = ScoreTable(self._run.out / run_folder.SCORES, first)
        with (
            Board(self._run.out / run_folder.TENSORBOARD if is_first else None, first) as board,
            tqdm(
                total=self.steps,
                initial=first,
                desc="train",
                unit="step",
                mininterval=1.0 if sys.stderr.isatty() else 30.0,  # a line of a log file
                disable=not is_first,
            ) as bar,
            read_batches(self._task, first) as batches,
        ):
            self._score_start(board)
            self._take_steps(batches, board, bar)

    def release(self) -> None:
        """Write model.pt, the change of the scores, and the page of the validation."""
        network = self._released()
        save_checkpoint(self._run.out / FINAL, network, training=self._facts())
        for line in self._scores.compare():
            self.tell(line)
        if not self._task.validation:
            return
        networks, init = {"after": network}, self._run.init
        if init is not None and init.network.config.classes == network.config.classes:
            before = copy.deepcopy(init.network).to(self._processes.device)
            networks = {"before": before, **networks}
            if before.config != network.config:
                self._results.pop("before", None)  # it was another network's
        path, curves = self._run.out / run_folder.PAGE, self._scores.curves
        write_validation(networks, self._task, path, known=self._results, curves=curves)

    def _score_start(self, board: Board) -> None:
        """Score the initial weights, or make up for a validation that was interrupted."""
        if not self.state.step:
            if self._task.validation and self._run.init is not None:
                self._score("before", self.state.averaged, board)
        elif self._is_due and self.state.step not in self._scores:
            # A run that was stopped or killed in a validation begins with it.
            self._score("after", self._released(), board)

    def _take_steps(self, batches: Iterator[Batch], board: Board, bar: tqdm) -> None:
        recipe, state, limit = self._recipe, self.state, self._run.stop_after
        last = self.steps if limit is None else min(self.steps, limit)
        if state.step < last:
            # In every process, since batch statistics are sums over all of them.
            minutes = (last - state.step) * state.estimate_step_s() / 60
            self.tell(f"the {last - state.step} steps take about {max(1, round(minutes))} minutes")
        while state.step < last and not self._processes.any_of(self._run.stop()):
            done = state.advance(batches)
            if bar.update():  # the loss is read from its device only when it is shown
                bar.set_postfix(loss=f"{done.terms['total'].item():.3f}", refresh=False)
            if state.step % recipe.log_every == 0:
                board.add_step(done, dict(state.criterion.log_variances.items()), state.step)
            # Before the validation, which takes long and may be ended by a kill.
            if self._is_due or state.step % recipe.checkpoint_every == 0:
                self.save()
            if self._is_due:
                self._score("after", self._released(), board)

    @property
    def _is_due(self) -> bool:
        """Whether the present step ends with a validation."""
        due = self.is_complete or self.state.step % self._recipe.validate_every == 0
        return bool(self._task.validation) and due

    def _score(self, name: str, network: Network, board: Board) -> None:
        """Validate; the first process alone writes the table and the best weights."""
        step = self.state.step
        self._results[name] = validate(name, network, self._task, board, step)
        figures = {result.row.data: result.row.figures for result in self._results[name]}
        best = self._recipe.validation.best
        if self._processes.is_first and self._scores.add(step, figures, best):
            save_checkpoint(self._run.out / BEST, network, training=self._facts())

    def _released(self) -> Network:
        """Return the averaged weights as they are released."""
        share = self._recipe.release.logit_adjustment
        return adjust_logits(self.state.averaged, self._task.criterion.class_weights, share)

    def _facts(self) -> dict[str, Any]:
        data, terms = state_provenance(self._recipe, self._run.init, self._run.teacher)
        return TrainingFacts(
            data=data,
            terms=terms,
            trained_height=self._recipe.model.trained_height,
            step=self.state.step,
            **self._resolved,
        ).to_dict()
