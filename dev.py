"""The commands of a contributor; `python3 dev.py --help` lists them.

Only the standard library is used, so that this file runs before anything is installed: the first
verb creates `.venv` next to this file and installs usarmjx and its pinned dependencies there.
"""

import sys


def python_problem(version: tuple) -> str:
    """Return why this version of Python cannot run usarmjx, or "" when it can."""
    if tuple(version[:2]) >= (3, 11):
        return ""
    found = ".".join(str(part) for part in version[:3])
    return f"usarmjx needs Python 3.11 or newer; {sys.executable} is Python {found}"


# Before everything else: the lines below would fail on an old Python with a worse message.
if python_problem(sys.version_info):
    sys.exit(python_problem(sys.version_info))

import argparse
import hashlib
import importlib.util
import json
import os
import subprocess
import time
import venv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent
PINNED_BY = ("pyproject.toml", "constraints.txt")
LOG_TAIL = 30  # lines of pip's output shown when an installation fails

# Two workers: a world compiles on every core that it gets, and more workers were not faster.
WORKERS = ("-n", "2", "--dist", "loadfile")
# A test that hangs, or ends its process, ends the run (xdist with another worker may wait for ever).
NO_HANGING = (
    *("-o", "faulthandler_timeout=600", "-o", "faulthandler_exit_on_timeout=true"),
    "--max-worker-restart=0",
)
# Tests that compile next to nothing, for `test --quick`.
QUICK = (
    "tests/base/test_registry.py",
    "tests/base/test_transforms.py",
    "tests/cli/test_sensor_tables.py",
    "tests/models/arenas/test_elements.py",
    "tests/models/generate",
    "tests/models/ini",
    "tests/models/roads",
    "tests/models/robots/test_ackermann.py",
    "tests/models/robots/test_manual_figures.py",
    "tests/models/robots/test_pioneer.py",
    "tests/sensors/test_limits.py",
    "tests/sensors/test_settings.py",
    "tests/server/protocol",
    "tests/server/messages/test_victims.py",
    "tests/server/wireless/test_dialect_a.py",
    "tests/server/wireless/test_dialect_b.py",
    "tests/test_conformance.py",
    "tests/test_dev.py",
    "tests/test_docs.py::test_commands_exist",
    "tests/test_docs.py::test_links_lead_to_files",
    "tests/test_names.py",
)
# A cross-section of the packages, run once more with the compiler's optimisation that users have.
OPTIMISED = (
    "tests/sensors/cameras/test_every_camera.py",
    "tests/comms/test_attenuation.py",
    "tests/comms/test_mail.py",
    "tests/engines/test_engines.py::test_jax_drives_as_c_mujoco_does",
    "tests/models/compile/test_body_plan.py",
    "tests/sensors/rays/test_raycast.py",
    "tests/server/test_joints_wire.py",
    "tests/sim/test_control.py",
    "tests/train/envs/test_env.py::test_a_world_is_the_same_alone_as_in_a_batch[c]",
    "tests/train/learning/test_ppo.py",
)


class SetupError(Exception):
    """The environment cannot be made; the message says what to do about it."""


@dataclass(frozen=True)
class Environment:
    """The virtual environment of one checkout.

    Attributes:
        root: The checkout, which holds pyproject.toml and constraints.txt.
        folder: Where the virtual environment is, or will be.
    """

    root: Path
    folder: Path

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    @property
    def stamp(self) -> Path:
        """The file that says what has been installed completely."""
        return self.folder / "usarmjx-installed.json"

    def fingerprint(self) -> str:
        """Hash what decides the packages, and the path, which an editable install remembers."""
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
    """Tell the person at the terminal; standard output belongs to the tools."""
    print(f"dev.py: {text}", file=sys.stderr, flush=True)


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


def usarmjx(*args: str) -> list[str]:
    """Command line of the product itself."""
    return ["-m", "usarmjx", *args]


def pytest(*args: str) -> list[str]:
    """Command line of the tests."""
    return ["-m", "pytest", *args]


def lint(*args: str) -> list[str]:
    """Command line of the style rules."""
    return ["-m", "ruff", "check", *args]


def formatter(*args: str) -> list[str]:
    """Command line of the code formatter."""
    return ["-m", "ruff", "format", *args]


def types(*args: str) -> list[str]:
    """Command line of the type checker."""
    return ["-m", "pyright", *args]


def layers(*args: str) -> list[str]:
    """Command line of the import rules; import-linter has no `-m` form."""
    run = "import sys; from importlinter.cli import lint_imports_command as main; sys.exit(main())"
    return ["-c", run, *args]


def quick(*args: str) -> list[list[str]]:
    """Lint, format check, layers and the quick tests; the arguments go to pytest."""
    return [lint(), formatter("--check"), layers(), pytest(*WORKERS, *QUICK, *args)]


def everything(*args: str) -> list[list[str]]:
    """All that CI runs; with arguments, only pytest with them."""
    if "--quick" in args:
        return quick(*(arg for arg in args if arg != "--quick"))
    if args:
        return [pytest(*args)]
    tests = [pytest(*WORKERS, *NO_HANGING), pytest("--optimised", *WORKERS, *NO_HANGING, *OPTIMISED)]
    return [lint(), formatter("--check"), types(), layers(), *tests]


def fuzz(*args: str) -> list[list[str]]:
    """The property tests with random examples."""
    return [pytest("-m", "hypothesis", "--hypothesis-profile", "fuzz", *args)]


@dataclass(frozen=True)
class Verb:
    """One command of this file.

    Attributes:
        summary: What it does, for the help.
        steps: Python command lines to run, given the arguments that followed the verb.
        extras: Optional dependencies that it needs; None: not even .venv, but this Python.
    """

    summary: str
    steps: Callable[..., list[list[str]]]
    extras: frozenset[str] | None = frozenset({"dev"})


VERBS = {
    "demo": Verb(
        "run the main job, checked (arguments go to `usarmjx demo --headless`)",
        lambda *args: [usarmjx("demo", "--headless", *args)],
        extras=frozenset(),
    ),
    "test": Verb(
        "lint, format check, types, layers and all tests; --quick: what needs no compilation;"
        " other arguments: pytest with them",
        everything,
    ),
    "fuzz": Verb("property tests with other examples each time (arguments go to pytest)", fuzz),
    "check": Verb("the same as test without arguments: everything that CI runs", everything),
    "format": Verb("rewrite the code with ruff format", lambda *args: [formatter(*args)]),
    "lint": Verb("ruff check", lambda *args: [lint(*args)]),
    "types": Verb("pyright", lambda *args: [types(*args)]),
    "layers": Verb("import-linter: who may import whom", lambda *args: [layers(*args)]),
    "oracle": Verb(
        "the tests that compare us with C MuJoCo and closed forms",
        lambda *args: [pytest("-m", "oracle", *args)],
    ),
    "bench": Verb("benchmarks (arguments go to `usarmjx bench`)", lambda *args: [usarmjx("bench", *args)]),
    "docs": Verb(
        "the documents as a site in build/site, their examples and links (with arguments: pytest with them)",
        lambda *args: [*([] if args else [["-m", "documents"]]), pytest("tests/test_docs.py", *args)],
    ),
    "try": Verb(
        "what a stranger does, in empty environments: the wheel, the demo, extras, first page (see --help)",
        lambda *args: [["trial.py", *args]],
        extras=None,
    ),
    "audit": Verb(
        "known vulnerabilities of the pinned packages, where pip-audit can run (status 2: it cannot)",
        lambda *args: [["dependencies.py", "audit", *args]],
    ),
    "sbom": Verb(
        "the pinned packages as CycloneDX JSON, with licences; to the file that is named, if any",
        lambda *args: [["dependencies.py", "sbom", *args]],
    ),
}


def parse(argv: Sequence[str]) -> tuple[Verb, list[str]]:
    """Return the verb and the arguments that go to its tool; argparse exits on a wrong verb."""
    parser = argparse.ArgumentParser(
        prog="dev.py",
        usage="python3 dev.py VERB [arguments for the tool]",
        description="What a contributor runs. The first use creates .venv and fills it.",
        epilog="verbs:\n" + "\n".join(f"  {name:8}{VERBS[name].summary}" for name in VERBS),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("verb", metavar="VERB", choices=VERBS, help="one of the verbs below")
    parser.add_argument("args", nargs=argparse.REMAINDER, help="passed on unchanged")
    options = parser.parse_args(argv)
    return VERBS[options.verb], options.args


def run_steps(environment: Environment, steps: Sequence[Sequence[str]]) -> int:
    """Run every step, also after a failure, and return the first bad status, else 0."""
    # jaxlib on two cores deadlocks when two batched factorisations share its pool of two threads.
    settings = {"NPROC": "8", **os.environ}
    # pyright looks for the packages of the first `python` on the path.
    settings["PATH"] = os.pathsep.join((str(environment.python.parent), os.environ.get("PATH", "")))
    failed: list[tuple[str, int]] = []
    for step in steps:
        words = [word for word in step[1:3] if not word.startswith("-")]
        name = " ".join(words) if step[0] == "-m" else "import-linter"
        if len(steps) > 1:
            say(name)
        command = [str(environment.python), *step]
        status = subprocess.run(command, cwd=environment.root, env=settings).returncode
        if status:
            failed.append((name, status if status > 0 else 128 - status))  # as a shell reports it
    if not failed:
        return 0
    if len(steps) > 1:
        say("failed: " + ", ".join(name for name, _ in failed))
    return failed[0][1]


def main(argv: Sequence[str]) -> int:
    """Run one verb and return its exit status."""
    verb, args = parse(argv)
    environment = Environment(ROOT, ROOT / ".venv")
    try:
        if verb.extras is None:
            (step,) = verb.steps(*args)
            return subprocess.run([sys.executable, *step], cwd=ROOT).returncode
        environment.ensure(verb.extras)
        return run_steps(environment, verb.steps(*args))
    except SetupError as error:
        say(str(error))
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
