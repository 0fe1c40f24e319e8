"""Signals while the command line is imported."""

import os
import signal
import subprocess
import sys

import pytest

from usarmjx.cli import entry


def test_a_signal_during_the_imports_is_one_line():
    code = (
        "import builtins, os, signal; from usarmjx.cli import entry; usual = builtins.__import__\n"
        "def slow(name, *rest):\n"
        "    if name == 'usarmjx.cli.app': os.kill(os.getpid(), signal.SIGINT)\n"
        "    return usual(name, *rest)\n"
        "builtins.__import__ = slow; entry.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "usarmjx: stopped by SIGINT\n")


@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN])
def test_afterwards_signals_mean_what_they_did(monkeypatch, handler):
    """What is ignored stays so, as in the background of a shell."""
    before, during = signal.signal(signal.SIGINT, handler), []
    monkeypatch.setattr("usarmjx.cli.app.app", lambda: during.append(signal.getsignal(signal.SIGINT)))
    try:
        entry.main()
        assert during == [handler]
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_status_is_that_of_shells(monkeypatch):
    told = []
    monkeypatch.setattr(os, "_exit", told.append)
    monkeypatch.setattr(os, "write", lambda stream, text: told.append((stream, text)))
    entry.end_early(signal.SIGTERM, None)
    assert told == [(2, b"usarmjx: stopped by SIGTERM\n"), 143]
