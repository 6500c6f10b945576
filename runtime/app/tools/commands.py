"""Entry points of the commands; each imports only its own module."""

from runtime.command.process import command_in

run = command_in("runtime.app.run.cli")
info, doctor, verify, bench, calibrate = (
    command_in(f"runtime.app.tools.{name}")
    for name in ("info", "doctor", "verify", "bench", "calibrate")
)
