"""Exit codes as docs/commands.md has them: 0, 1 (failed), 2 (could not be tried), 130 (interrupted)."""

import io
import json
import re
import signal
import subprocess
import sys
import threading

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

import dev
from usarmjx.base.errors import EngineError, PeerError, UsageError, WriteError
from usarmjx.base.progress import RateLimitedLog
from usarmjx.cli import doctor
from usarmjx.cli.app import app
from usarmjx.cli.common import BAD_INPUT, FAILED, INTERRUPTED, ErrorExit
from usarmjx.cli.demo_run import DemoError
from usarmjx.cli.doctor import Finding
from usarmjx.train.learning.metrics import MetricsLog

PATIENCE = 300.0  # s


def invoke(*words):
    return CliRunner().invoke(app, list(words))


def test_the_document_has_them():
    text = (dev.ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    told = [int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)]
    assert told == [0, FAILED, BAD_INPUT, INTERRUPTED]


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UsageError("x"), BAD_INPUT),
        (EngineError("x"), BAD_INPUT),
        (WriteError("x"), BAD_INPUT),
        (DemoError("x"), FAILED),
        (PeerError("x"), FAILED),
    ],
)
def test_our_errors_are_a_line_and_a_code(error, code, capsys):
    with pytest.raises(typer.Exit) as caught, ErrorExit():
        raise error
    assert caught.value.exit_code == code
    assert capsys.readouterr().err == "usarmjx: x\n"


@pytest.mark.parametrize(
    "words",
    [
        ("lst",),
        ("serve", "--prot", "3"),
        ("serve", "--worlds", "many"),
        ("list", "cats"),
        ("play",),
        ("arena", "draw", "yellow"),
    ],
)
def test_what_was_typed_wrong_is_2_and_says_what_is_allowed(words):
    result = invoke(*words)
    assert (result.exit_code, result.stdout) == (BAD_INPUT, "")
    assert result.stderr


def test_what_did_not_come_out_well_is_1(monkeypatch, tmp_path):
    monkeypatch.setattr("usarmjx.cli.demo_run.run_demo", lambda *_: 1)
    assert invoke("demo", "--headless", "--out", str(tmp_path)).exit_code == FAILED
    monkeypatch.setattr(doctor, "CHECKS", (lambda: iter([Finding("x", "wrong", "y")]),))
    assert invoke("doctor", "--no-self-test").exit_code == FAILED


INTERRUPTIBLE = {
    "list tasks": "usarmjx.cli.tables.LISTINGS",
    "eval explore-v1": "usarmjx.cli.task_options.PolicyOptions.source",
    "play explore-v1 --engine c": "usarmjx.cli.task_options.PolicyOptions.source",
    "train explore-v1 --out x": "usarmjx.cli.train._train",
    "doctor": "usarmjx.cli.doctor.run_checks",
    "portraits --out x.png": "usarmjx.plots.gallery.portraits",
    "bench step": "benchmarks.step.measure_step",
    "demo --headless": "usarmjx.cli.demo_run.run_demo",
}


@pytest.mark.parametrize("command", INTERRUPTIBLE)
def test_ctrl_c_is_130_and_no_trace(command, monkeypatch, tmp_path):
    def interrupt(*args, **options):
        raise KeyboardInterrupt

    class Interrupts(dict):
        def __getitem__(self, key):
            raise KeyboardInterrupt

        def __contains__(self, key):
            return True

        def __iter__(self):
            return iter(["tasks"])

    monkeypatch.chdir(tmp_path)
    where = INTERRUPTIBLE[command]
    monkeypatch.setattr(where, Interrupts() if where.endswith("LISTINGS") else interrupt)
    result = invoke(*command.split())
    assert result.exit_code == INTERRUPTED
    assert "Traceback" not in result.output


def test_a_signal_while_a_command_works_is_130():
    """A process of its own, which is told to end while it builds a batch of worlds."""
    # What a shell starts in the background ignores interrupts, and so would its children.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "sys.argv = ['usarmjx', 'train', 'explore-v1', '--out', 'x']\n"
    code += "import usarmjx.train.learning.processes as launch, time\n"
    code += "launch.process_info = lambda _: (print('here', flush=True), time.sleep(600))\n"
    code += "from usarmjx.cli.app import app; app()"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=dev.ROOT
    )
    watchdog = threading.Timer(PATIENCE, process.kill)
    watchdog.start()
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    _, complaints = process.communicate()
    watchdog.cancel()
    assert (process.returncode, complaints) == (INTERRUPTED, "")


# Progress without a terminal


def test_lines_come_seldom():
    told, now = [], [0.0]
    seldom = RateLimitedLog(told.append, period=15.0, clock=lambda: now[0])
    for second in range(61):
        now[0] = float(second)
        seldom(f"{second}")
    assert told == ["15", "30", "45", "60"]


def test_a_training_without_a_terminal_tells_how_far_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr("usarmjx.base.progress.RateLimitedLog.__init__.__defaults__", (0.0, lambda: 0.0))
    record = {"agent_steps": 10, "steps_per_s": 1234.5, "return": 0.5, "score": 2.0, "bad": 0.0}
    said = {}
    for terminal in (False, True):
        file = io.StringIO()
        console = Console(file=file, force_terminal=terminal, width=200)
        with MetricsLog(tmp_path / str(terminal), 4, console=console) as log:
            log.write({"iteration": 1, **record})
        said[terminal] = file.getvalue()
    assert "usarmjx: 0/4 iterations, compiling\n" in said[False]
    assert "usarmjx: 1/4 iterations  1,234 steps/s  return 0.5  score 2  bad worlds 0.00%\n" in said[False]
    assert "iterations" not in said[True]
    lines = (tmp_path / "False" / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["iteration"] for line in lines] == [1]
