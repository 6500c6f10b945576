"""Options that several commands share, and commands whose options are the fields of a class."""

import dataclasses
import inspect
from collections.abc import Callable, Collection, Mapping
from enum import StrEnum
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand

import runtime
from runtime.base.errors import InputError
from runtime.command.wording import with_flags

_Command = Callable[..., None]
_Options = TypeVar("_Options")


class UsageError(InputError):
    """Options that are wrong by themselves, whatever the files contain."""


class Provider(StrEnum):
    """Choices of --provider."""

    cpu = "cpu"
    cuda = "cuda"


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ssdnet {runtime.__version__}")
        raise typer.Exit


# The option --threads of the commands that run one model.
Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
]
# The option --version of every command; `with_options` adds it.
_VERSION = typer.Option(
    "--version", callback=_print_version, is_eager=True, help="Print the version."
)
Version = Annotated[bool, _VERSION]


@dataclasses.dataclass(frozen=True)
class _Given:
    """What a command takes for a field: its option, the type there, and how the value is read."""

    info: Any
    type: Any
    read: Callable[[Any], Any]


def option_group(title: str | None = None) -> Callable[..., Any]:
    """Return a function that defines a field as an option, in this group of --help.

    It takes the help, the names on the command line, and what `kind` (typer.Option or
    typer.Argument) takes. `given` is the type on the command line, if it is not that of the field,
    and `read` makes the field's value of it; such an option that is not given has the field's
    default.
    """

    def option(
        text: str,
        *names: str,
        default: Any = None,
        kind: Callable[..., Any] = typer.Option,
        given: Any = None,
        read: Callable[[Any], Any] = lambda value: value,
        **settings: Any,
    ) -> Any:
        info = kind(*names, help=text, rich_help_panel=title, **settings)
        return dataclasses.field(default=default, metadata={_Given: _Given(info, given, read)})

    return option


def with_options(options: type, names: Collection[str] = ()) -> Callable[[_Command], _Command]:
    """Give typer --version and a parameter for each field of a class, which come as **given.

    `names` are the names of the fields; empty: all that are options.
    """

    def decorate(command: _Command) -> _Command:
        shown = []
        for field in dataclasses.fields(options):
            given = field.metadata.get(_Given)
            if given is None or (names and field.name not in names):
                continue
            default = field.default if given.type is None else None
            shown.append(_keyword(field.name, given.type or field.type, given.info, default))
        *others, _ = inspect.signature(command).parameters.values()
        shown += [*others, _keyword("_version", bool, _VERSION, False)]
        command.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        command.__annotations__ = {each.name: each.annotation for each in shown}
        return command

    return decorate


def _keyword(name: str, of_type: Any, info: Any, default: Any) -> inspect.Parameter:
    """A parameter of a command; a default that is MISSING makes it required."""
    default = inspect.Parameter.empty if default is dataclasses.MISSING else default
    annotation = Annotated[of_type, info]
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def read_options(options: type[_Options], given: Mapping[str, Any], **others: Any) -> _Options:
    """Make an object of a class with options from what its command was given, and from others.

    Raises typer.BadParameter for a UsageError.
    """
    try:
        for field in dataclasses.fields(options):  # type: ignore[arg-type]
            if (value := given.get(field.name)) is not None:
                others[field.name] = field.metadata[_Given].read(value)
        return options(**others)
    except UsageError as error:
        raise typer.BadParameter(with_flags(str(error))) from error


class GroupedCommand(TyperCommand):
    """A command whose --help shows the options by their `rich_help_panel`, as plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            if (row := parameter.get_help_record(ctx)) is not None:
                title = getattr(parameter, "rich_help_panel", None) or "Other"
                groups.setdefault(title, []).append(row)
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)
