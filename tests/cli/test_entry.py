"""Signals while the command line is imported."""

import os
import signal
import subprocess
import sys

import pytest

import dev
from tests.scripts import python_path
from usarmjx.base import early_signals
from usarmjx.cli import entry, lazy_commands

HEARD = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""Begin of a program that hears SIGINT where the tests run in the background of a shell, which ignores it."""


def test_a_signal_during_the_imports_is_one_line():
    code = (
        f"{HEARD}import builtins, os; from usarmjx.cli import entry; usual = builtins.__import__\n"
        "def slow(name, *rest):\n"
        "    if name == 'usarmjx.cli.app': os.kill(os.getpid(), signal.SIGINT)\n"
        "    return usual(name, *rest)\n"
        "builtins.__import__ = slow; entry.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "usarmjx: stopped by SIGINT\n")


@pytest.mark.parametrize("number", early_signals.EARLY_SIGNALS)
def test_so_is_one_before_the_package_has_imported_anything(tmp_path, number):
    """`sitecustomize` runs before the package: the signal comes with the package's first own import."""
    (tmp_path / "sitecustomize.py").write_text(
        f"{HEARD}import builtins, os; usual = builtins.__import__\n"
        "def slow(name, *rest):\n"
        f"    if name == 'ctypes': os.kill(os.getpid(), {int(number)})\n"
        "    return usual(name, *rest)\n"
        "builtins.__import__ = slow"
    )
    path = os.pathsep.join([str(tmp_path), python_path(dev.ROOT)])
    done = subprocess.run(
        [sys.executable, "-m", "usarmjx", "list", "robots"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )
    said = f"usarmjx: stopped by {number.name}\n"
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", said)


@pytest.mark.parametrize(
    ("argv", "words", "answer"),
    [
        (["/venv/bin/usarmjx", "serve"], ["python", "/venv/bin/usarmjx", "serve"], True),
        (["-m", "serve"], ["python", "-X", "dev", "-m", "usarmjx", "serve"], True),
        (["-m"], ["python", "-m", "pytest"], False),
        (["/venv/bin/usarmjx", "sweep"], ["python", "-c", "from multiprocessing.spawn import ..."], False),
        (["own.py", "usarmjx"], ["python", "own.py", "usarmjx"], False),
        (["-c"], ["python", "-c", "import usarmjx"], False),
    ],
)
def test_only_the_command_itself_catches_signals(monkeypatch, argv, words, answer):
    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(sys, "orig_argv", words)
    assert early_signals.is_command() is answer


@pytest.mark.parametrize("number", early_signals.EARLY_SIGNALS)
@pytest.mark.parametrize("place", ["lazy.import_module", "typer.core.TyperCommand.parse_args"])
def test_so_is_one_while_a_command_is_imported_or_parsed(number, place):
    code = (
        f"{HEARD}import os, sys, typer; from usarmjx.cli import entry, lazy_commands as lazy\n"
        f"{place} = lambda *a: os.kill(os.getpid(), {int(number)})\n"
        "sys.argv[1:] = ['list', 'robots']; entry.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    said = f"usarmjx: stopped by {number.name}\n"
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", said)


@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN, lambda number, frame: None])
def test_while_a_command_runs_signals_mean_what_they_did(monkeypatch, handler):
    """What is ignored stays so, as in the background of a shell."""
    before, during = signal.signal(signal.SIGINT, handler), []

    def note(context):
        during.append((context, signal.getsignal(signal.SIGINT)))

    monkeypatch.setattr("usarmjx.cli.app.app", lambda: lazy_commands.with_usual_signals(note)("its context"))
    try:
        entry.main()
        assert during == [("its context", handler)]
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_after_a_command_that_is_none_they_mean_that_again(monkeypatch):
    def refuse():
        assert signal.getsignal(signal.SIGTERM) is early_signals.end_early
        raise SystemExit(2)

    monkeypatch.setattr("usarmjx.cli.app.app", refuse)
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit):
            entry.main()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)


def test_commands_restore_them(monkeypatch):
    command = lazy_commands.load_command("doctor", "usarmjx.cli.doctor:doctor", "")
    restored = []
    monkeypatch.setattr(early_signals, "restore_signals", lambda: restored.append(True))
    monkeypatch.setattr(command, "callback", lambda **options: None)
    with command.make_context("doctor", []) as context:
        assert restored == []
        command.invoke(context)
    assert restored == [True]


def test_the_status_is_that_of_shells(monkeypatch):
    told = []
    monkeypatch.setattr(os, "_exit", told.append)
    monkeypatch.setattr(os, "write", lambda stream, text: told.append((stream, text)))
    early_signals.end_early(signal.SIGTERM, None)
    assert told == [(2, b"usarmjx: stopped by SIGTERM\n"), 143]
