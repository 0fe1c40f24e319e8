"""Peers as folders: what each is, the environment it runs in, and a process that measures it."""

import json
import os
import subprocess
import sys
import venv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from usarmjx.base.errors import UsageError, UsarmjxError

DESCRIPTION, SCRIPT, REQUIREMENTS = "peer.yaml", "measure.py", "requirements.txt"
TOLD = ("robot", "has", "lacks", "settings")
"""What is told of every rate; a variant may have its own words for it."""
FIGURES = ("warm_up", "first_s", "times_s", "period_s", "steps", "device", "versions")
"""What a measuring process prints."""
ON_HOST = ("cpu", "host")
"""Devices that are no accelerator."""
LAST_LINES = 3
"""Of what a process complained about, in a message."""


class ContestantError(UsarmjxError):
    """A peer could not be installed or measured."""


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another simulator, as its `peer.yaml` has it.

    Attributes:
        folder: With its script and its requirements.
        name: Its name.
        variants: Measured variants; under each its rays of a robot (`beams`, else none), and of `TOLD`
            what differs from the others.
        robot: Kind of robot in it.
        has: Contents of its step.
        lacks: Omissions.
        settings: Its command.
        authors: A figure of its authors', in their words; none: "".
        citation: Its source.
        host: Whether it runs on the host's processor alone.
    """

    folder: Path
    name: str
    variants: Mapping[str, Mapping[str, Any]]
    robot: str
    has: str
    lacks: str
    settings: str
    authors: str = ""
    citation: str = ""
    host: bool = False

    def about(self, variant: str) -> dict[str, Any]:
        """Return what a reader must know of a variant's rate."""
        told = {name: getattr(self, name) for name in (*TOLD, "authors", "citation")}
        return {**told, "beams": 0, **self.variants[variant]}


def read_peers(folder: Path, names: Sequence[str] = ()) -> list[Peer]:
    """Return the peers of a folder.

    Args:
        folder: Of the folders.
        names: Those that are wanted; none: all.

    Raises:
        UsageError: There are none there, or not these, or one does not describe itself.
    """
    found = {path.parent.name: path for path in sorted(folder.glob(f"*/{DESCRIPTION}"))}
    if not found:
        raise UsageError(f"{folder} has no peers; it is benchmarks/peers in a source tree: --folder DIR")
    if unknown := [name for name in names if name not in found]:
        raise UsageError(f"no peer is called {unknown[0]!r}; known: {', '.join(found)}")
    return [_read(found[name]) for name in names or found]


def _read(file: Path) -> Peer:
    try:
        peer = Peer(folder=file.parent, **yaml.safe_load(file.read_text(encoding="utf-8")))
    except (TypeError, yaml.YAMLError) as error:
        raise UsageError(f"{file}: {str(error).splitlines()[0]}") from error
    for variant, own in peer.variants.items():
        if odd := [name for name in own if name not in (*TOLD, "beams")]:
            raise UsageError(f"{file}: {variant!r} cannot have {odd[0]!r}, but {', '.join(TOLD)}, beams")
    return peer


def python_of(environment: Path) -> Path:
    """Return the interpreter of an environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def ensure_environment(peer: Peer, folder: Path, *, install: bool) -> Path:
    """Return the interpreter of a peer's environment, which is made if it is not there.

    Args:
        peer: The peer.
        folder: Of the environments of all peers.
        install: Whether one may be made; pip takes its index from its own settings.

    Raises:
        ContestantError: There is none and none may be made, or its packages could not be installed.
    """
    environment = folder / peer.folder.name
    python = python_of(environment)
    if python.exists():
        return python
    if not install:
        raise ContestantError(f"{peer.name} has no environment at {environment}")
    wanted = ["-m", "pip", "install", "--quiet", "-r", str(peer.folder / REQUIREMENTS)]
    try:
        venv.create(environment, with_pip=True)
        done = subprocess.run([str(python), *wanted], capture_output=True, text=True)
        if done.returncode:
            raise ContestantError(f"{peer.name} cannot be installed: {_last_lines(done.stderr)}")
    except BaseException:  # failed or interrupted: half of its packages may be there
        python.unlink(missing_ok=True)
        raise
    return python


def _last_lines(text: str) -> str:
    return " / ".join(line.strip() for line in text.strip().splitlines()[-LAST_LINES:])


def ask_process(words: Sequence[str], limit: float) -> dict[str, Any]:
    """Return what a measuring process prints last, a line of JSON.

    Args:
        words: Its command line; without a path the interpreter is ours.
        limit: After which it is ended [s].

    Raises:
        ContestantError: It failed, took too long, or did not say what is needed.
    """
    command = list(words) if Path(words[0]).exists() else [sys.executable, *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        raise ContestantError(f"not done after {limit:g} s") from None
    if done.returncode:
        raise ContestantError(_last_lines(done.stderr) or f"ended with status {done.returncode}")
    try:
        found = json.loads(done.stdout.strip().splitlines()[-1])
    except (IndexError, json.JSONDecodeError):
        raise ContestantError(f"said no figures: {_last_lines(done.stdout)}") from None
    if missing := [name for name in FIGURES if name not in found]:
        raise ContestantError(f"said no {missing[0]!r}")
    return found
