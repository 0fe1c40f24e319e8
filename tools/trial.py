"""What `dev.py try` does: all that a stranger does first, in empty environments, which it makes and deletes.

It builds the wheel, looks at what is in it, and for each Python installs it without constraints and tries
what the base installation promises; then each extra, and each library of `trial_libraries` that is named, in
an environment of its own. Needs the standard library only.
"""

import argparse
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Timer
from typing import TypeAlias

from tools.trial_libraries import LIBRARIES, PAGE

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "NOTICE")
"""What the wheel is made of beside the package."""
PYTHONS = ("python3.11", "python3.12", "python3.13")
"""Those that pyproject.toml names; tried where they are found."""
EXTRAS = ("train", "rl", "warp", "cuda")
FIRST_PAGES = ("docs/start.md", "README.md")
NOTEBOOK = "examples/first_batch.ipynb"
PORTS = (3000, 5874, 50000, 7435, 5003)
"""The usual ones of `usarmjx serve`."""
OFFSET = 100
"""As for `--port-offset`, where somebody has one of them."""
LIMIT = 1800.0
"""So long a command may take, downloads and compilation included [s]."""
TAIL = 25
"""Lines of a failed command that are shown."""
FENCE = re.compile(r"^```(\w+)(?: (\S+))?[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


class TrialError(Exception):
    """Something did not work as a stranger would expect; the message has what was said."""


@dataclass(frozen=True)
class Room:
    """An empty folder with an environment of its own.

    Attributes:
        folder: Folder in which commands run.
        wheel: Name of the trial.
    """

    folder: Path
    wheel: Path

    @property
    def programs(self) -> Path:
        """The folder of the environment's programs."""
        return self.folder.parent / f"{self.folder.name}-venv" / ("Scripts" if os.name == "nt" else "bin")

    def settings(self) -> dict[str, str]:
        """Return variables without what would lead out of the room."""
        kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
        kept["PATH"] = os.pathsep.join((str(self.programs), kept.get("PATH", "")))
        return {**kept, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "COLUMNS": "200"}

    def run(self, *words: str, status: int = 0) -> str:
        """Run one of the environment's programs; return what it says.

        Raises:
            TrialError: It ends with another status; has what it said last.
        """
        program = shutil.which(words[0], path=str(self.programs))
        if program is None:
            raise TrialError(f"there is no program {words[0]}")
        done = subprocess.run(
            [program, *words[1:]],
            cwd=self.folder,
            env=self.settings(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=LIMIT,
        )
        if done.returncode != status:
            last = "\n".join(done.stdout.splitlines()[-TAIL:])
            raise TrialError(
                f"{' '.join(words)[:200]}\nended with status {done.returncode}, not {status}:\n{last}"
            )
        return done.stdout

    def python(self, code: str) -> str:
        """Run a program; return what it says."""
        return self.run("python", "-c", code)

    def install(self, extra: str = "", *others: str) -> None:
        """Install the wheel as anybody would, and others beside it: no constraints."""
        self.run("pip", "install", f"{self.wheel}[{extra}]" if extra else str(self.wheel), *others)
        self.run("pip", "check")


def expect(right: object, text: str) -> None:
    """Refuse what is not as it should be."""
    if not right:
        raise TrialError(text)


def pieces(page: str) -> tuple[dict[str, str], str]:
    """Return the files that a page names, and the program that its python blocks are together."""
    named = {name: body for _, name, body in FENCE.findall(page) if name}
    return named, "\n".join(body for kind, name, body in FENCE.findall(page) if kind == "python" and not name)


def cells(notebook: str) -> str:
    """Return the program that a notebook's cells are together, without lines for the notebook's shell."""
    sources = [
        "".join(cell["source"]) for cell in json.loads(notebook)["cells"] if cell["cell_type"] == "code"
    ]
    return "\n".join(line for one in sources for line in one.splitlines() if not line.startswith(("%", "!")))


def says_its_version(room: Room) -> None:
    """Both the command and the package."""
    version = room.python("import usarmjx; print(usarmjx.__version__)").strip()
    for option in ("--version", "-V"):
        expect(version in room.run("usarmjx", option), f"usarmjx {option} does not say {version}")


def imports_little(room: Room) -> None:
    """`import usarmjx` and the client library load nothing heavy."""
    room.python(
        "import sys, usarmjx, usarmjx.client.wander as wander; "
        "heavy = {'jax', 'mujoco', 'numpy'} & set(sys.modules); assert not heavy, heavy; "
        "print(usarmjx.TASKS.names(), usarmjx.POLICIES.names())"
    )


def demonstration(room: Room) -> None:
    """The judged run: a server of a batch, a client over TCP, a picture."""
    room.run("usarmjx", "demo", "--headless", "--seconds", "5", "--out", "demo")
    expect((room.folder / "demo" / "wander.png").stat().st_size > 10_000, "the demonstration drew no picture")


def packaged_policies(room: Room) -> None:
    """They play, are evaluated and exported, without an extra."""
    room.run("usarmjx", "play", "drive-to-goal", "--seconds", "2", "--out", "play.png")
    room.run("usarmjx", "eval", "drive-to-goal", "--episodes", "2", "--engine", "c")
    room.run("usarmjx", "export", "drive-to-goal", "--out", "goal.npz")
    expect((room.folder / "goal.npz").exists(), "no policy was exported")


def names_what_is_missing(room: Room) -> None:
    """A command that needs an extra names it in its last line."""
    said = room.run("usarmjx", "train", "--task", "drive-to-goal", "--out", "run", "--worlds", "4", status=2)
    expect(said.strip().endswith('pip install "usarmjx[train]"'), f"train says:\n{said}")


def first_pages(room: Room) -> None:
    """Their programs run, and so does the controller that the first page has one write."""
    for number, name in enumerate(FIRST_PAGES):
        named, program = pieces((ROOT / name).read_text(encoding="utf-8"))
        for file, body in named.items():
            (room.folder / file).write_text(body, encoding="utf-8")
        (room.folder / f"page{number}.py").write_text(program, encoding="utf-8")
        room.run("python", f"page{number}.py")
    if (room.folder / "drive.py").exists():
        first_controller(room)


def first_controller(room: Room) -> None:
    """`usarmjx serve --arena yellow` in one terminal, `python drive.py` in another."""
    offset = free_offset()
    command = [str(room.programs / "usarmjx"), "serve", "--arena", "yellow", "--viewer-port", "0"]
    command += ["--port-offset", str(offset)] if offset else []
    script = room.folder / "drive.py"
    text = script.read_text(encoding="utf-8").replace(f"port={PORTS[0]}", f"port={PORTS[0] + offset}")
    script.write_text(text, encoding="utf-8")
    with subprocess.Popen(
        command, cwd=room.folder, env=room.settings(), stdout=subprocess.PIPE, text=True
    ) as server:
        watchdog = Timer(LIMIT, server.kill)
        watchdog.start()
        try:
            assert server.stdout is not None
            expect(any("listening on" in line for line in server.stdout), "usarmjx serve does not listen")
            said = room.run("python", "drive.py")
            expect("free ahead" in said, f"drive.py says:\n{said}")
        finally:
            watchdog.cancel()
            server.send_signal(signal.SIGINT if os.name != "nt" else signal.SIGTERM)


def free_offset() -> int:
    """Return how far from the usual ports a server finds all of them free: 0 where nobody else serves."""

    def is_free(port: int) -> bool:
        try:
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            return False
        return True

    offsets = range(0, 65535 - max(PORTS), OFFSET)
    return next(offset for offset in offsets if all(is_free(port + offset) for port in PORTS))


def notebook(room: Room) -> None:
    """Its cells, in order."""
    (room.folder / "notebook.py").write_text(cells((ROOT / NOTEBOOK).read_text(encoding="utf-8")), "utf-8")
    room.run("python", "notebook.py")


def training(room: Room) -> None:
    """A little training, its curves, its policy."""
    small = ("--worlds", "4", "--steps", "2000", "--engine", "c", "--set", "physics=fast")
    room.run("usarmjx", "train", "--task", "drive-to-goal", *small, "--out", "run", "--quiet")
    room.run("usarmjx", "curves", "run", "--out", "curves.png")
    room.run("usarmjx", "export", "run", "--out", "run.npz", "--checkpoint", "last")


def other_libraries(room: Room) -> None:
    """The interfaces of Gymnasium, PettingZoo and JaxMARL."""
    room.python(
        "import usarmjx, usarmjx.train.adapters.jaxmarl, usarmjx.train.adapters.pettingzoo\n"
        "from usarmjx.train.adapters.gymnasium import VectorWorlds\n"
        "worlds = VectorWorlds(usarmjx.make('drive-to-goal', worlds=2, engine='c'))\n"
        "obs, _ = worlds.reset(seed=1)\n"
        "assert obs.shape[0] == 2, obs.shape\n"
    )


def warp_engine(room: Room) -> None:
    """The engine is there, and steps."""
    room.python(
        "import usarmjx\n"
        "batch = usarmjx.Batch(usarmjx.build_scene('yellow', ['P2AT']), 2, engine='warp')\n"
        "batch.step(batch.reset())\n"
    )


def sees_a_gpu(room: Room) -> None:
    """JAX computes on it."""
    room.python("import jax; assert jax.devices()[0].platform == 'gpu', jax.devices()")


def example_of(name: str) -> Callable[[Room], str]:
    """Return the trial of a library: what our page shows of it; it returns what that prints last."""

    def its_example_of_the_page(room: Room) -> str:
        program = LIBRARIES[name].program((ROOT / PAGE).read_text(encoding="utf-8"))
        (room.folder / "example.py").write_text(program, encoding="utf-8")
        return "; ".join(room.run("python", "example.py").splitlines()[-2:])

    return its_example_of_the_page


Trial: TypeAlias = Callable[[Room], str | None]
BASE: tuple[Trial, ...] = (
    says_its_version,
    imports_little,
    names_what_is_missing,
    packaged_policies,
    demonstration,
    first_pages,
    notebook,
)
OF_EXTRA: dict[str, tuple[Trial, ...]] = {
    "train": (training,),
    "rl": (other_libraries,),
    "warp": (warp_engine,),
    "cuda": (sees_a_gpu, warp_engine),
}


def build(folder: Path, python: str, isolated: bool = True) -> Path:
    """Build the wheel from a copy of the sources, into a folder; return the file.

    Args:
        folder: For the copy and the wheel.
        python: Whose pip builds it.
        isolated: Let pip fetch the build's tools; else those that are installed are used, and no network.

    Raises:
        TrialError: It cannot be built.
    """
    copy = folder / "sources"
    for name in (*SOURCES, *package_files()):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy / name)
    command = [python, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(folder), "."]
    command += [] if isolated else ["--no-build-isolation", "--no-index"]
    done = subprocess.run(command, cwd=copy, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    made = list(folder.glob("usarmjx-*.whl"))
    if done.returncode or len(made) != 1:
        raise TrialError(f"the wheel cannot be built:\n{done.stdout[-3000:]}")
    return made[0]


def wheel_faults(wheel: Path, wanted: Iterable[str]) -> list[str]:
    """Return what is wrong with the contents of a wheel.

    Args:
        wheel: The file.
        wanted: Paths of the files of the package, from the root of the repository.
    """
    with zipfile.ZipFile(wheel) as held:
        names = {name for name in held.namelist() if not name.endswith("/")}
        about = next(name for name in names if name.endswith(".dist-info/METADATA"))
        metadata = held.read(about).decode()
    package = {name for name in names if ".dist-info/" not in name}
    faults = [f"{name} is missing" for name in sorted(set(wanted) - package)]
    faults += [f"{name} does not belong there" for name in sorted(package - set(wanted))]
    licences = {name.rpartition("/")[2] for name in names if ".dist-info/licenses/" in name}
    faults += [f"{name} is missing" for name in ("LICENSE", "NOTICE") if name not in licences]
    for line in (
        "License-Expression: Apache-2.0",
        "Requires-Python: >=3.11",
        "Description-Content-Type: text/markdown",
    ):
        faults += [] if line in metadata else [f"its metadata does not say {line}"]
    return faults


def package_files() -> list[str]:
    """Return the files of the package that the repository has or is about to have."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "usarmjx"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in listed.stdout.splitlines() if (ROOT / name).exists()]


@dataclass
class Account:
    """Tells what was tried, and remembers what failed."""

    failed: list[str] = field(default_factory=list)

    def attempt(self, what: str, trial: Callable[[], object]) -> bool:
        """Try something and say how it went; return whether it did."""
        began = time.monotonic()
        try:
            said = trial()
        except (TrialError, OSError, subprocess.SubprocessError) as error:
            print(f"FAILED  {what}\n{error}", flush=True)
            self.failed.append(what)
            return False
        result = f": {said}" if isinstance(said, str) and said else ""
        print(f"ok      {what} ({time.monotonic() - began:.0f} s){result}", flush=True)
        return True


def try_room(account: Account, folder: Path, python: str, wheel: Path, wanted: str) -> None:
    """Make an empty environment, install what is wanted, and try what belongs to it.

    Args:
        account: Of what was tried.
        folder: For the environment.
        python: To make it with.
        wheel: The file.
        wanted: An extra, a library, or `base`.
    """
    name = f"{Path(python).name}{f' [{wanted}]' if wanted != 'base' else ''}"
    room = Room(folder / f"{Path(python).name}-{wanted}", wheel)
    room.folder.mkdir()
    venv = room.programs.parent
    extras, others, trials = wanted, (), OF_EXTRA.get(wanted, ())
    if wanted == "base":
        extras, trials = "", BASE
    elif wanted in LIBRARIES:
        library = LIBRARIES[wanted]
        extras, others, trials = ",".join(library.extras), library.requirements, (example_of(wanted),)

    def install() -> None:
        subprocess.run([python, "-m", "venv", str(venv)], check=True)
        room.install(extras, *others)

    if account.attempt(f"{name}: installs", install):
        for trial in trials:
            words = trial.__name__.replace("_", " ")
            account.attempt(f"{name}: {words}", lambda trial=trial: trial(room))
    shutil.rmtree(venv, ignore_errors=True)


def usable(names: Sequence[str]) -> list[str]:
    """Return those of several Pythons that are there and run; without any, this one."""
    found = [path for name in names if (path := shutil.which(name))]
    works = [p for p in found if subprocess.run([p, "-c", ""], capture_output=True).returncode == 0]
    return works or [sys.executable]


def main(argv: Sequence[str]) -> int:
    """Try it all and return the exit status: 1 if anything failed."""
    parser = argparse.ArgumentParser(prog="dev.py try", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--python", action="append", help="which to try; else those of 3.11 to 3.13 that are found"
    )
    parser.add_argument(
        "--only",
        action="append",
        choices=("base", *EXTRAS, *LIBRARIES),
        help="try the base installation, one with an extra, or one with another library, most of which bring"
        " PyTorch; else base and all extras, cuda only where nvidia-smi is",
    )
    options = parser.parse_args(argv)
    pythons = usable(options.python or PYTHONS)
    usual = ["base", *(extra for extra in EXTRAS if extra != "cuda" or shutil.which("nvidia-smi"))]
    wanted = options.only or usual
    account = Account()
    with tempfile.TemporaryDirectory(prefix="usarmjx-try-") as place:
        folder, wheels = Path(place), list[Path]()
        if account.attempt("the wheel is built", lambda: wheels.append(build(folder / "wheel", pythons[-1]))):
            faults = wheel_faults(wheels[0], package_files())
            account.attempt(
                "the wheel has all it needs and no more", lambda: expect(not faults, "\n".join(faults))
            )
            for python in pythons if "base" in wanted else ():
                try_room(account, folder, python, wheels[0], "base")
            for name in (*EXTRAS, *LIBRARIES):
                if name in wanted:
                    try_room(account, folder, pythons[-1], wheels[0], name)
    print(f"{len(account.failed)} failed{': ' if account.failed else ''}{'; '.join(account.failed)}")
    return int(bool(account.failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
