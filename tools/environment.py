"""The virtual environment of a checkout: made, filled with the pinned packages, and used.

Needs the standard library only, so that it runs before anything is installed.
"""

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

PINNED_BY = ("pyproject.toml", "constraints.txt")
"""Files of a checkout that decide the packages."""
LOG_TAIL = 30
"""Lines of pip's output shown when an installation fails."""


class SetupError(Exception):
    """The environment cannot be made; the message says what to do about it."""


@dataclass(frozen=True)
class Environment:
    """The virtual environment of one checkout.

    Attributes:
        root: The checkout, which holds pyproject.toml and constraints.txt.
        folder: Folder of the virtual environment, which may not exist yet.
    """

    root: Path
    folder: Path

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    @property
    def stamp(self) -> Path:
        """The file that records a complete installation."""
        return self.folder / "usarmjx-installed.json"

    def fingerprint(self) -> str:
        """Hash the files that decide the packages, and the path, which an editable install remembers."""
        digest = hashlib.sha256(str(self.root).encode())
        for name in PINNED_BY:
            digest.update(b"\0" + (self.root / name).read_bytes())
        return digest.hexdigest()

    def installed(self) -> frozenset[str] | None:
        """Return the extras that are installed and current; None when not even the package is."""
        try:
            stamp = json.loads(self.stamp.read_text(encoding="utf-8"))
            current = stamp["fingerprint"] == self.fingerprint() and self.python.exists()
            return frozenset(stamp["extras"]) if current else None
        except (OSError, ValueError, KeyError, TypeError):
            return None  # missing or damaged: install again

    def ensure(self, extras: frozenset[str]) -> None:
        """Install the package with these extras, unless that was done already.

        Raises:
            SetupError: The environment could not be made.
        """
        present = self.installed()
        if present is not None and extras <= present:
            return
        self.stamp.unlink(missing_ok=True)  # an interrupted installation is repeated
        self._create()
        wanted = extras | (present or frozenset())
        self._install(wanted)
        content = {"fingerprint": self.fingerprint(), "extras": sorted(wanted)}
        unfinished = self.stamp.with_suffix(".unfinished")
        unfinished.write_text(json.dumps(content), encoding="utf-8")
        os.replace(unfinished, self.stamp)

    def _has_pip(self) -> bool:
        command = [str(self.python), "-m", "pip", "--version"]
        return self.python.exists() and subprocess.run(command, capture_output=True).returncode == 0

    def _create(self) -> None:
        """Create the environment; nothing that is already in the folder is deleted."""
        if self._has_pip():
            return
        if importlib.util.find_spec("ensurepip") is None:
            raise SetupError(
                f"{sys.executable} cannot make virtual environments (no ensurepip);"
                " on Debian and Ubuntu: apt install python3-venv"
            )
        say(f"creating {self.folder}")
        try:
            venv.EnvBuilder(with_pip=True, symlinks=os.name != "nt").create(self.folder)
        except (OSError, subprocess.CalledProcessError) as error:
            raise SetupError(f"cannot create {self.folder}: {error}") from error
        if not self._has_pip():
            raise SetupError(f"{self.folder} is broken; delete it and try again")

    def _install(self, extras: frozenset[str]) -> None:
        """Run pip, which takes its index and proxies from its own configuration."""
        package = f".[{','.join(sorted(extras))}]" if extras else "."
        size = "470 MB" if "dev" in extras else "240 MB"
        say(f"downloading {size} for usarmjx{package[1:]} into {self.folder}: one to five minutes")
        started = time.monotonic()
        command = [str(self.python), "-m", "pip", "install", "--disable-pip-version-check"]
        command += ["--editable", package, "--constraint", "constraints.txt"]
        log = self.folder / "usarmjx-install.log"
        status, lines = follow(command, self.root)
        log.write_text("".join(lines), encoding="utf-8")
        if status:
            tail = "".join(lines[-LOG_TAIL:])
            raise SetupError(f"{tail}pip failed with status {status}; all of its output: {log}")
        say(f"installed in {time.monotonic() - started:.0f} s")


def say(text: str) -> None:
    """Print a line to standard error; standard output belongs to the tools."""
    print(f"dev.py: {text}", file=sys.stderr, flush=True)


def clock(seconds: float) -> str:
    """Return a duration as minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def follow(command: Sequence[str], folder: Path) -> tuple[int, list[str]]:
    """Run a command, show its latest line when a terminal watches, return status and output."""
    terminal = sys.stderr.isatty()
    lines: list[str] = []
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, cwd=folder, stdout=pipe, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if terminal:
                print(f"\r\033[K  {line.strip()[:76]}", end="", file=sys.stderr, flush=True)
    if terminal:
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    return process.returncode, lines


class Beside(list[str]):
    """A step that runs beside the next one that is none of this class, after others before it that are.

    Its output is shown when that step has ended.
    """


def kept_programs(root: Path) -> Path:
    """Return the folder of programs that tests compile: one for all checkouts, so that new ones find them.

    Args:
        root: A checkout, which keeps them itself where the user's cache folder cannot be written.
    """
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "usarmjx-tests"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return root / "build" / "tests"
    return folder


class StepRun:
    """A run of the steps of a verb.

    Args:
        environment: Where they run.
        is_long: Whether it reports each step and its duration.
    """

    def __init__(self, environment: Environment, is_long: bool) -> None:
        self._environment, self._is_long = environment, is_long
        # jaxlib on two cores deadlocks when two batched factorisations share its pool of two threads.
        self._variables = {"NPROC": "8", **os.environ}
        # pyright looks for the packages of the first `python` on the path.
        path = (str(environment.python.parent), os.environ.get("PATH", ""))
        self._variables["PATH"] = os.pathsep.join(path)
        self.failed: list[tuple[str, int]] = []

    def say(self, text: str) -> None:
        """Print a line if the run has several steps."""
        if self._is_long:
            say(text)

    def step(self, step: Sequence[str], output: IO[bytes] | None = None) -> None:
        """Run one step.

        Args:
            step: Arguments of Python.
            output: File for its output; None: where that of this process goes.
        """
        words = [word for word in step[1:3] if not word.startswith("-") or word.startswith("--")]
        name = " ".join(words) if step[0] == "-m" else "import-linter"
        self.say(name)
        command = [str(self._environment.python), *step]
        if list(step[:2]) == ["-m", "pytest"] and "USARMJX_TEST_CACHE" not in self._variables:
            self._variables["USARMJX_TEST_CACHE"] = str(kept_programs(self._environment.root))
        started = time.monotonic()
        errors = None if output is None else subprocess.STDOUT
        run = subprocess.run(
            command, cwd=self._environment.root, env=self._variables, stdout=output, stderr=errors
        )
        self.say(f"{name}: {clock(time.monotonic() - started)}")
        if status := run.returncode:
            self.failed.append((name, status if status > 0 else 128 - status))  # as a shell reports it

    def steps_beside(self, steps: Sequence[Sequence[str]], longer: Sequence[str]) -> None:
        """Run steps one after another while a longer one runs, and show their output after it."""
        interrupted = threading.Event()

        def run_all(output: IO[bytes]) -> None:
            for step in steps:
                if not interrupted.is_set():
                    self.step(step, output)

        with tempfile.TemporaryFile() as output:
            others = threading.Thread(target=run_all, args=(output,))
            others.start()
            try:
                self.step(longer)
                others.join()
            except KeyboardInterrupt:
                interrupted.set()
                raise
            finally:
                others.join()
                output.seek(0)
                print(output.read().decode(errors="replace"), end="", flush=True)


def run_steps(environment: Environment, steps: Sequence[Sequence[str]]) -> int:
    """Run every step, also after a failure, and return the first bad status, else 0."""
    run, beside = StepRun(environment, len(steps) > 1), list[Sequence[str]]()
    started = time.monotonic()
    for step in steps:
        if isinstance(step, Beside):
            beside.append(step)
        elif beside:
            run.steps_beside(beside, step)
            beside = []
        else:
            run.step(step)
    for step in beside:  # no other step has come after them
        run.step(step)
    run.say(f"all steps: {clock(time.monotonic() - started)}")
    if not run.failed:
        return 0
    run.say("failed: " + ", ".join(name for name, _ in run.failed))
    return run.failed[0][1]
