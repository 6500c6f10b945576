"""What the options of `ssdnet-run` say, checked: a mistake is told before anything is opened."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from runtime.errors import InputError
from runtime.network_size import NetworkSize, parse_network_size
from runtime.predictor import Predictor
from runtime.run.outputs.rerun_log import LIVE, RERUN_SUFFIX, is_file, is_viewer
from runtime.run.run_folder import CLOUD, KINDS, SAVED_HEADS, SUFFIXES
from runtime.sources.registry import choose_source
from runtime.sources.source import Source

MAX_SHARDS = 1_000_000

NamedFiles = dict[str, tuple[Path | None, str]]  # option -> file asked for, its ending


def parse_kinds(save: str) -> tuple[str, ...]:
    """Read --save. Raises BadParameter for a kind that it does not know."""
    if save in ("all", "none"):
        return KINDS if save == "all" else ()
    asked = [kind.strip() for kind in save.split(",")]
    unknown = [kind for kind in asked if kind not in SUFFIXES]
    if unknown:
        raise typer.BadParameter(f"--save knows {', '.join(SUFFIXES)}, all and none, not {unknown}")
    return tuple(kind for kind in SUFFIXES if kind in asked)


def parse_source(text: str, **options: Any) -> Callable[[], Source]:
    """Read --source and give back what opens it.

    Raises BadParameter for a kind or an option that it does not know.
    """
    try:
        return choose_source(text, **options)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error


def answered_kinds(
    kinds: tuple[str, ...], predictor: Predictor, *, everything: bool
) -> tuple[str, ...]:
    """Return the kinds that the model answers. Raises InputError if one was asked for by name."""
    needed = {**{kind: head for kind, (head, _) in SAVED_HEADS.items()}, CLOUD: "depth"}
    missing = [kind for kind in kinds if kind in needed and needed[kind] not in predictor.heads]
    if missing and not everything:
        raise InputError(
            f"--save asks for {', '.join(missing)}, the model {predictor.contract.model_name} "
            f"answers {', '.join(predictor.heads)}: leave it out, or choose another --model"
        )
    return tuple(kind for kind in kinds if kind not in missing)


def parse_size(text: str) -> NetworkSize:
    """Read --size. Raises BadParameter."""
    try:
        return parse_network_size(text)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error


def parse_shard(text: str | None) -> tuple[int, int]:
    """Read "2/4" as (2, 4); the whole is the first part of one. Raises BadParameter."""
    part, _, parts = (text or "1/1").partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts) <= MAX_SHARDS):
        raise typer.BadParameter(
            f"--shard is I/N with 1 <= I <= N <= {MAX_SHARDS}, such as 2/4, got {text!r:.80}"
        )
    return int(part), int(parts)


def require_suffixes(files: NamedFiles) -> None:
    """Raise BadParameter for a file of another kind than its option writes."""
    for option, (path, suffix) in files.items():
        if path is not None and path.suffix.lower() != suffix:
            raise typer.BadParameter(f"{option} writes {suffix} files, got {path}")


def require_rerun_target(target: str) -> None:
    """Raise BadParameter for what --rerun cannot log to."""
    if not (is_file(target) or is_viewer(target)):
        raise typer.BadParameter(
            f"--rerun takes a file that ends in {RERUN_SUFFIX}, {LIVE}, or a viewer's "
            f"rerun+http://HOST:PORT/proxy, got {target!r:.80}"
        )


def require_range(option: str, value: float | None, least: float, most: float) -> None:
    """Raise BadParameter for a number out of range; None is not given."""
    if value is not None and not least <= value <= most:
        raise typer.BadParameter(
            f"{option} must be a number from {least:g} to {most:g}, got {value}"
        )
