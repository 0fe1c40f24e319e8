"""The wheel has all that it needs, and `dev.py try` finds what is wrong with one."""

import json
import os
import shutil
import socket
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import dev
import usarmjx
from tools import trial
from usarmjx.server.network.ports import BOT_PORT, IMAGE_PORT, POSITION_PORT, WSS2_PORT, WSS_PORT

pytestmark = pytest.mark.tools

USE = """
import os
from pathlib import Path
import usarmjx, usarmjx.client.wander
from usarmjx.cli import app, demo_run
from usarmjx.models.arenas.arda import FILES
from usarmjx.train.policies import POLICIES

here = Path(usarmjx.__file__).parent
assert here.parent == Path(os.environ["PYTHONPATH"]), here
assert demo_run.CONTROLLER.is_relative_to(here) and demo_run.CONTROLLER.exists()
assert all(file.exists() for file in FILES)
assert usarmjx.load_policy("drive-to-goal").learned
assert len(POLICIES) == len(list(here.glob("train/policies/*.npz"))) >= 3
assert (here / "py.typed").exists()
"""


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built with the tools that are installed: there is no network here."""
    return trial.build(tmp_path_factory.mktemp("wheel"), sys.executable, isolated=False)


def test_the_wheel_has_the_whole_package_and_nothing_else(wheel: Path):
    files = trial.package_files()
    assert trial.wheel_faults(wheel, files) == []
    assert len(files) > 400
    assert {Path(name).suffix for name in files} >= {".py", ".typed", ".npz", ".txt"}
    assert wheel.name == f"usarmjx-{usarmjx.__version__}-py3-none-any.whl"


def test_what_is_wrong_with_a_wheel_is_found(wheel: Path, tmp_path: Path):
    spoilt = tmp_path / wheel.name
    with zipfile.ZipFile(wheel) as whole, zipfile.ZipFile(spoilt, "w") as made:
        for name in whole.namelist():
            if not name.endswith(("py.typed", "/NOTICE")):
                text = whole.read(name)
                made.writestr(name, text.replace(b"Apache-2.0", b"unknown") if "METADATA" in name else text)
        made.writestr("tests/test_x.py", "")
    assert trial.wheel_faults(spoilt, trial.package_files()) == [
        "usarmjx/py.typed is missing",
        "tests/test_x.py does not belong there",
        "NOTICE is missing",
        "its metadata does not say License-Expression: Apache-2.0",
    ]


def test_an_installed_wheel_needs_nothing_of_the_repository(wheel: Path, tmp_path: Path):
    place, empty = tmp_path / "installed", tmp_path / "empty"
    empty.mkdir()
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-compile", "--quiet"]
    subprocess.run([*command, "--target", str(place), str(wheel)], check=True, capture_output=True)
    settings = {**os.environ, "PYTHONPATH": str(place)}
    for words in (
        ["-c", USE],
        ["-m", "usarmjx", "demo", "--help"],
        ["-m", "usarmjx.client.wander", "--help"],
    ):
        done = subprocess.run(
            [sys.executable, *words], cwd=empty, env=settings, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr


def test_what_a_page_and_a_notebook_have_a_reader_run_is_found():
    page = (
        "```python\na = 1\n```\n```py drive.py\nprint(2)\n```\n```console\n$ x\n```\n```python\nb = a\n```\n"
    )
    assert trial.pieces(page) == ({"drive.py": "print(2)\n"}, "a = 1\n\nb = a\n")
    code = {"cell_type": "code", "source": ["%pip install usarmjx\n", "!ls\n", "x = 1\n", "x"]}
    assert (
        trial.cells(json.dumps({"cells": [code, {"cell_type": "markdown", "source": ["no"]}]})) == "x = 1\nx"
    )


def test_libraries_are_tried_with_the_examples_of_the_page_and_the_versions_of_the_workflow():
    page = (dev.ROOT / trial.PAGE).read_text(encoding="utf-8")
    workflow = (dev.ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    extras = tomllib.loads((dev.ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    for library in trial.LIBRARIES.values():
        program = library.program(page)
        compile(program, library.title, "exec")
        assert "from usarmjx.train.adapters import" in program
        assert "```" not in program
        assert set(library.extras) <= extras.keys()
        pinned = [one for one in library.requirements if "==" in one]
        assert all(one in workflow for one in pinned), pinned


def test_an_environment_gets_what_its_library_asks_for(tmp_path, monkeypatch, capsys):
    installed, wheel = [], tmp_path / "x.whl"
    monkeypatch.setattr(trial.subprocess, "run", lambda *_, **__: None)
    monkeypatch.setattr(trial.Room, "install", lambda _, *words: installed.append(words))
    monkeypatch.setattr(trial.Room, "run", lambda room, *_: f"much\nmean 1.5\n{room.folder.name} 2.0\n")
    account = trial.Account()
    for name in ("sb3", "rllib"):
        trial.try_room(account, tmp_path, "python3", wheel, name)
    assert installed == [("rl,sb3",), ("", "ray[rllib]==2.60.0", "torch==2.15.0", "pettingzoo>=1.27")]
    assert "[sb3]: its example of the page (0 s): mean 1.5; python3-sb3 2.0" in capsys.readouterr().out


def test_the_first_page_has_programs_to_try():
    found = [trial.pieces((dev.ROOT / name).read_text(encoding="utf-8")) for name in trial.FIRST_PAGES]
    assert "drive.py" in found[0][0]
    assert "usarmjx" in found[0][1]


def test_failures_are_told_and_the_rest_is_still_tried(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    if os.name == "nt":
        pytest.skip("the program is a shell script")
    room = trial.Room(tmp_path / "room", tmp_path / "x.whl")
    room.folder.mkdir()
    room.programs.mkdir(parents=True)
    program = room.programs / "usarmjx"
    program.write_text('#!/bin/sh\necho "said $*" $(pwd) $PYTHONPATH\n[ "$1" != bad ]\n')
    program.chmod(0o755)
    account = trial.Account()
    assert not account.attempt("one", lambda: room.run("usarmjx", "bad"))
    assert not account.attempt("two", lambda: room.run("usarmjy"))
    assert account.attempt("three", lambda: room.run("usarmjx", "good"))
    assert room.run("usarmjx", "bad", status=1) == f"said bad {room.folder}\n"
    shown = capsys.readouterr().out
    assert account.failed == ["one", "two"]
    assert "FAILED  one\nusarmjx bad\nended with status 1, not 0:\nsaid bad" in shown
    assert "there is no program usarmjy" in shown
    assert "ok      three" in shown


def test_try_is_a_verb_that_needs_no_environment(monkeypatch: pytest.MonkeyPatch):
    calls = []

    def run(command, **_):
        calls.append(command)
        return subprocess.CompletedProcess(command, 3)

    monkeypatch.setattr(dev.subprocess, "run", run)
    monkeypatch.setattr(dev.Environment, "ensure", lambda *_: pytest.fail("it wants .venv"))
    assert dev.main(["try", "--only", "base"]) == 3
    assert calls == [[sys.executable, "-m", "tools.trial", "--only", "base"]]


def test_pythons_that_do_not_run_are_not_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    broken = tmp_path / "python3.99"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert trial.usable(["python3.99", "no-such-python"]) == [sys.executable]
    assert trial.usable([sys.executable]) == [shutil.which(sys.executable)]


def test_the_notebook_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    text = (dev.ROOT / trial.NOTEBOOK).read_text(encoding="utf-8")
    assert "%pip install --quiet ./usarmjx-*.whl" in text
    names: dict[str, object] = {}
    monkeypatch.setattr(plt, "show", lambda: None)
    exec(compile(trial.cells(text), trial.NOTEBOOK, "exec"), names)
    shown = capsys.readouterr().out
    assert "m before the wall" in shown
    assert "tasks: convoy drive-to-goal" in shown
    track = names["track"]
    turned = track[-1, :, 1] - track[0, :, 1]  # to the right is -y of our axes
    assert (np.diff(turned) < 0).all(), "whose right wheels are slower turn further to the right"


@pytest.mark.parametrize(
    ("argv", "rooms"),
    [([], ["base", "train", "rl", "warp"]), (["--only", "rl"], ["rl"]), (["--only", "base"], ["base"])],
)
def test_it_is_tried_in_rooms_of_their_own_and_failures_decide(argv, rooms, monkeypatch):
    tried = []
    monkeypatch.setattr(trial, "build", lambda folder, python: folder / "x.whl")
    monkeypatch.setattr(trial, "wheel_faults", lambda wheel, files: [])
    monkeypatch.setattr(
        trial.shutil, "which", lambda name, **_: None if name == "nvidia-smi" else sys.executable
    )

    def try_room(account, folder, python, wheel, extra):
        tried.append(extra or "base")
        account.attempt(extra, lambda: trial.expect(extra != "rl", "no"))

    monkeypatch.setattr(trial, "try_room", try_room)
    assert trial.main(["--python", "this", *argv]) == int("rl" in rooms)
    assert tried == rooms


def test_where_somebody_serves_the_trial_s_server_moves():
    ports = (BOT_PORT, WSS_PORT, WSS2_PORT, POSITION_PORT, IMAGE_PORT)
    assert ports == trial.PORTS
    free = trial.free_offset()
    with socket.create_server(("127.0.0.1", trial.PORTS[1] + free)):
        assert trial.free_offset() > free
    assert trial.free_offset() % trial.OFFSET == 0
