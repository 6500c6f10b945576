"""What the commands do with errors and Ctrl-C."""

import importlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

import runtime
from runtime.base.errors import InputError
from runtime.command.process import reported_errors, stop_requested


@pytest.mark.parametrize(("error", "code", "text"), [
    (InputError("the fault"), 1, "error: the fault\n"),
    (ModuleNotFoundError("No module named 'x'"), 1,
     "error: No module named 'x': pip install -c constraints.txt \".[train]\" "
     "in a clone of ssdnet\n"),
    (ImportError("libGL.so.1: cannot open"), 1,
     "error: libGL.so.1: cannot open: it is installed but cannot be loaded, ssdnet-doctor examines "
     "it\n"),
    (KeyboardInterrupt(), 130, ""),
], ids=["ours", "missing package", "broken package", "Ctrl-C"])  # fmt: skip
def test_an_error_is_a_line_and_an_exit_code(capfd, error, code, text):
    with pytest.raises(SystemExit) as caught, reported_errors("train"):
        raise error
    assert caught.value.code == code
    assert capfd.readouterr().err == text


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_block_that_can_be_interrupted_cleans_up(number):
    before = signal.getsignal(number)
    cleaned = []

    def work():
        with stop_requested(interrupts=True):
            try:
                signal.raise_signal(number)
            finally:
                cleaned.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert cleaned
    assert signal.getsignal(number) == before


@pytest.mark.parametrize(("block", "code"), [
    ("signal.raise_signal(signal.SIGINT)", 130),
    ("signal.raise_signal(signal.SIGTERM)", 130),
    ("signal.raise_signal(signal.SIGHUP)", 130),
    # A second one does not wait for what the first one cleans up.
    ("import time\n"
     "with stop_requested(interrupts=True):\n"
     "  try: signal.raise_signal(signal.SIGINT)\n"
     "  finally: time.sleep(0.3); signal.raise_signal(signal.SIGINT); time.sleep(60)", 130),
    ("signal.signal(signal.SIGINT, signal.SIG_IGN); begin_command(); "
     "signal.raise_signal(signal.SIGINT); sys.exit(7)", 7),
    ("signal.signal(signal.SIGHUP, signal.SIG_IGN); begin_command(); "
     "signal.raise_signal(signal.SIGHUP); sys.exit(7)", 7),
], ids=["Ctrl-C", "SIGTERM", "SIGHUP", "twice", "deaf from the start", "nohup"])  # fmt: skip
def test_a_process_ends_without_a_traceback(block, code):
    program = f"import signal, sys\nfrom runtime.command.process import *\nbegin_command()\n{block}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_a_deleted_working_folder_is_an_error_of_one_line(tmp_path):
    program = "import os, sys\nfrom runtime.command.process import *\nbegin_command()\n"
    program += "os.rmdir(os.getcwd())\nwith reported_errors('cpu'): BLOCK"
    blocks = "os.path.realpath('x')", "raise FileNotFoundError('x')", "begin_command()"
    for number, block in enumerate(blocks):
        (folder := tmp_path / str(number)).mkdir()
        arguments = [sys.executable, "-c", program.replace("BLOCK", block)]
        done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 1
        assert done.stderr == (
            "error: the working folder was deleted or remounted: change to another one, or again to"
            " this one, by cd\n"
        )
    with pytest.raises(FileNotFoundError), reported_errors("cpu"):
        raise FileNotFoundError("a fault of the program stays one")


def test_a_closed_terminal_ends_no_command(tmp_path):
    shown, terminal = os.openpty()
    program = "import sys\nfrom runtime.command.process import *\nbegin_command()\n"
    program += "with stop_requested() as stop, progress_bar(3, 'frames') as advance:\n"
    program += "  advance(); sys.stdin.readline(); advance(); advance()\n"
    program += "print_result('done'); sys.exit(7 if stop() else 8)"
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE, stdout=terminal, stderr=terminal, start_new_session=True,
    )  # fmt: skip
    os.close(terminal)
    while b"frames" not in os.read(shown, 4096):
        pass
    os.close(shown)
    process.send_signal(signal.SIGHUP)
    process.communicate(b"\n", timeout=60)
    assert process.returncode == 7


# Computes for minutes in a library, where Python handles no signal.
HANGS = """
import hashlib
from runtime.command.process import stop_requested
with stop_requested(**OPTIONS) as stop:
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", ROUNDS)
    print(stop())
"""


@pytest.mark.parametrize("numbers", [(signal.SIGINT,) * 2, (signal.SIGTERM, signal.SIGINT)])
def test_the_second_signal_ends_a_process_that_hangs(start_process, numbers):
    program = HANGS.replace("OPTIONS", "{}").replace("ROUNDS", "2_000_000_000")
    process = start_process(sys.executable, "-c", program)
    assert process.stdout.readline() == "ready\n"
    for number in numbers:
        assert process.poll() is None
        process.send_signal(number)
        time.sleep(0.3)
    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 130


@pytest.mark.parametrize(("options", "numbers", "apart_s", "rounds"), [
    ("{}", [signal.SIGTERM] * 2, 0, 300_000),  # as timeout(1) sends it
    ("{'second_ends': False}", [signal.SIGINT, signal.SIGTERM], 0.3, 1_500_000),
])  # fmt: skip
def test_one_signal_is_a_request_to_stop(start_process, options, numbers, apart_s, rounds):
    program = HANGS.replace("OPTIONS", options).replace("ROUNDS", str(rounds))
    process = start_process(sys.executable, "-c", program)
    assert process.stdout.readline() == "ready\n"
    for number in numbers:
        process.send_signal(number)
        time.sleep(apart_s)
    assert process.communicate(timeout=60) == ("True\n", "")
    assert process.returncode == 0


PYPROJECT = Path(__file__).parents[3] / "pyproject.toml"
SCRIPTS = tomllib.loads(PYPROJECT.read_text())["project"]["scripts"]
# They start as ssdnet-run does.
TOOLS = ("ssdnet-bench", "ssdnet-doctor", "ssdnet-info", "ssdnet-verify")


@pytest.fixture
def type_in(monkeypatch, capfd):
    """Type a command: its exit code, and what it printed on stdout and stderr."""

    def run(name, *arguments):
        module, function = SCRIPTS[name].split(":")
        if not module.startswith("runtime.") and importlib.util.find_spec("torch") is None:
            pytest.skip("the engine alone is installed")
        # pytest has its own signals.
        monkeypatch.setattr("runtime.command.process.begin_command", lambda: None)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        with pytest.raises(SystemExit) as ended:
            getattr(importlib.import_module(module), function)()
        return ended.value.code, *capfd.readouterr()

    return run


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_command_prints_its_version(type_in, name):
    assert type_in(name, "--version") == (0, f"ssdnet {runtime.__version__}\n", "")


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name not in TOOLS])
def test_ctrl_c_while_a_command_imports(start_process, name):
    """-X importtime tells how far it is."""
    module, function = SCRIPTS[name].split(":")
    if not module.startswith("runtime.") and importlib.util.find_spec("torch") is None:
        pytest.skip("the engine alone is installed")
    program = f"from {module} import {function}; {function}()"
    process = start_process(sys.executable, "-X", "importtime", "-c", program)
    for line in process.stderr:
        if line.rpartition("|")[2].strip().startswith("typer."):
            break
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate()
    assert (process.returncode, stdout) == (130, "")
    assert not [line for line in stderr.splitlines() if not line.startswith("import time:")]
