"""The live demonstration: what it says, when it opens a browser, and whether its robots move."""

import os
import re
import subprocess
import sys
import threading
import webbrowser
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import dev
from usarmjx.cli import demo
from usarmjx.cli.app import app
from usarmjx.cli.demo import DemoGuide, has_display, starting_at
from usarmjx.client.usarsim_client import UsarsimClient
from usarmjx.models.arenas import ARENAS

PAGE = "http://127.0.0.1:8100/"
TURNED = 0.3  # rad: in 20 reports, while its wheels turn it by more than that in each second
PATIENCE = 300.0  # s


@pytest.mark.parametrize(
    ("environment", "platform", "there"),
    [
        ({}, "linux", False),
        ({"DISPLAY": ""}, "linux", False),
        ({"DISPLAY": ":0"}, "linux", True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", True),
        ({"BROWSER": "w3m"}, "linux", True),
        ({}, "darwin", True),
        ({}, "win32", True),
    ],
)
def test_where_a_browser_can_show_something(environment, platform, there):
    assert has_display(environment, platform) == there


@pytest.mark.parametrize("browser", [True, False])
def test_the_guide_tells_once_and_opens_the_page_if_it_may(browser, monkeypatch, capsys):
    opened = threading.Event()
    asked = []
    monkeypatch.setattr(webbrowser, "open", lambda address: (asked.append(address), opened.set()))
    guide = DemoGuide(PAGE, 3001, ["P2AT0", "P2AT3"], browser)
    for _ in range(3):
        guide.tick()
    if browser:
        assert opened.wait(PATIENCE)
    assert asked == [PAGE] * browser
    told = capsys.readouterr().out
    assert told.count(PAGE) == 1
    for word in ("Take the controls", "P2AT3", "usarmjx console 3001", "Ctrl-C"):
        assert word in told


def test_no_browser_that_can_be_opened_is_no_fault(monkeypatch):
    def fail(address):
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "open", fail)
    demo.open_page(PAGE)


def test_what_is_recommended_exists(monkeypatch):
    lines = demo.guide_text(PAGE, 3000, ["P2AT3"]).splitlines()
    commands = [
        re.split(r"\s{3,}", line.strip())[0].split() for line in lines if line.startswith("  usarmjx")
    ]
    assert len(commands) == 4
    for words in commands:
        result = CliRunner().invoke(app, [words[1], "--help"], env={"COLUMNS": "200"})
        assert result.exit_code == 0
        assert all(word in result.output for word in words if word.startswith("--"))


def test_the_team_starts_where_it_should():
    yellow = ARENAS.get("yellow")
    moved = starting_at(yellow, demo.STARTS)
    assert tuple(start.tag for start in moved.starts[:4]) == demo.STARTS
    assert {start.tag for start in moved.starts} == {start.tag for start in yellow.starts}
    assert replace(moved, starts=yellow.starts) == yellow


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--seconds", "5"], "--seconds is for --headless"),
        (["--headless", "--port", "0"], "ports are for the live demonstration"),
        (["--headless", "--rosbridge-port", "0"], "ports are for the live demonstration"),
    ],
)
def test_options_of_the_other_form_are_refused(words, says):
    result = CliRunner().invoke(app, ["demo", *words])
    assert (result.exit_code, result.stdout) == (2, "")
    assert says in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.slow
def test_robots_move_and_one_can_be_taken_over(tmp_path):
    """The whole of it as a process, with an empty compilation cache: until a client drives one robot."""
    environment = {**os.environ, "USARMJX_CACHE": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-m", "usarmjx", "demo", "--no-browser", "--port", "0", "--viewer-port", "0"]
    process = subprocess.Popen(
        command, cwd=dev.ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    watchdog = threading.Timer(PATIENCE, process.kill)
    watchdog.start()
    try:
        said = []
        for line in process.stdout:
            said.append(line)
            if line.startswith("Ctrl-C"):
                break
        text = "".join(said)
        port = int(re.search(r"listening on 127\.0\.0\.1:(\d+)", text)[1])
        assert "4 robots explore yellow" in text
        with UsarsimClient("127.0.0.1", port, timeout=PATIENCE) as client:
            client.init("USARBot.P2AT", "P2AT3", (0.0, 0.0, 0.0))
            client.drive(2.0, -2.0)
            headings = []
            while len(headings) < 20:
                message = client.receive(PATIENCE)
                if message.kind == "SEN" and message.values("Type") == ["INS"]:
                    headings.append(message.vector("Orientation")[2])
        turned = np.abs(np.diff(np.unwrap(headings))).sum()
        assert turned > TURNED, "it does what its client says"
    finally:
        watchdog.cancel()
        process.terminate()
        _, complaints = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "compiling ... " in complaints or "compiled" in complaints
