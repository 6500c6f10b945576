"""`ssdnet-doctor`: whether the installation works, and the command that fixes it if not."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from runtime.command import ERROR, Provider, print_result, reported_errors
from runtime.command_options import NoDevice, Version
from runtime.tools.doctor import Check, examine

DOCTOR_FORMAT, DOCTOR_VERSION = "ssdnet-doctor", "1.0"


app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 the engine works; 1 a fault was found; 2 usage.")
def doctor(
    provider: Annotated[
        Provider,
        typer.Option(help="Provider of the self-test; with cuda, a missing GPU is a fault."),
    ] = Provider.cpu,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON document instead of the lines.")
    ] = False,
    _device: NoDevice = None,
    _version: Version = False,
) -> None:
    """Report versions, providers and libraries, and run each bundled model for a second."""
    with reported_errors("cpu"):
        checks = []
        printed = True
        for check in examine(provider.value):
            checks.append(check)
            if not as_json:
                printed = print_result(_line(check)) and printed
        faults = sum(check.status == "fault" for check in checks)
        if as_json:
            document = {
                "format": DOCTOR_FORMAT,
                "version": DOCTOR_VERSION,
                "provider": provider.value,
                "ok": not faults,
                "checks": [asdict(check) for check in checks],
            }
            printed = print_result(json.dumps(document, indent=2))
        else:
            printed = print_result(_verdict(faults, provider.value)) and printed
        raise typer.Exit(ERROR if faults or not printed else 0)


def _line(check: Check) -> str:
    text = f"{check.status:8}{check.name:24} {check.found}"
    return f"{text}\n{'':8}-> {check.remedy}" if check.remedy else text


def _verdict(faults: int, provider: str) -> str:
    if faults:
        return (
            f"{faults} fault{'s' * (faults > 1)}: run the commands after the arrows in a clone of "
            "ssdnet, in this order"
        )
    return f"the engine works on {provider}"
