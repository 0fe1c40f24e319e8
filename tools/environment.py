"""The virtual environment of a checkout: made, filled with the pinned packages, and used.

Needs the standard library only, so that it runs before anything is installed.
"""

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
import time
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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


def run_steps(environment: Environment, steps: Sequence[Sequence[str]]) -> int:
    """Run every step, also after a failure, and return the first bad status, else 0."""
    # jaxlib on two cores deadlocks when two batched factorisations share its pool of two threads.
    settings = {"NPROC": "8", "USARMJX_TEST_CACHE": str(environment.root / "build" / "tests"), **os.environ}
    # pyright looks for the packages of the first `python` on the path.
    settings["PATH"] = os.pathsep.join((str(environment.python.parent), os.environ.get("PATH", "")))
    failed: list[tuple[str, int]] = []
    started = time.monotonic()
    for step in steps:
        words = [word for word in step[1:3] if not word.startswith("-")]
        name = " ".join(words) if step[0] == "-m" else "import-linter"
        if len(steps) > 1:
            say(name)
        command = [str(environment.python), *step]
        step_started = time.monotonic()
        status = subprocess.run(command, cwd=environment.root, env=settings).returncode
        if len(steps) > 1:
            say(f"{name}: {clock(time.monotonic() - step_started)}")
        if status:
            failed.append((name, status if status > 0 else 128 - status))  # as a shell reports it
    if len(steps) > 1:
        say(f"all steps: {clock(time.monotonic() - started)}")
    if not failed:
        return 0
    if len(steps) > 1:
        say("failed: " + ", ".join(name for name, _ in failed))
    return failed[0][1]
