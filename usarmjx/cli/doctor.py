"""`usarmjx doctor`: is everything here that usarmjx needs, and does it run?"""

import contextlib
import gc
import importlib.metadata
import importlib.util
import io
import json as json_format
import math
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import usarmjx
from usarmjx.base import process
from usarmjx.base.compilation import CACHE_VARIABLE, cache_folder, enable_compilation_cache
from usarmjx.base.errors import UsarmjxError, quoted
from usarmjx.base.installation import install_command
from usarmjx.cli.common import ErrorExit, JsonFlag, announce, say
from usarmjx.server.network.ports import (
    BOT_PORT,
    IMAGE_PORT,
    POSITION_PORT,
    VIEWER_PORT,
    WSS2_PORT,
    WSS_PORT,
    bound_socket,
)

if TYPE_CHECKING:
    from usarmjx.client.usarsim_client import ServerMessage, UsarsimClient
    from usarmjx.models.types.arena import ArenaSpec
    from usarmjx.models.types.robot import RobotSpec
    from usarmjx.models.types.shapes import Shape


Verdict = Literal["ok", "note", "wrong"]
HOST = "127.0.0.1"
OLDEST_PYTHON = (3, 11)
PORTS = {
    "--port": BOT_PORT,
    "--wss-port": WSS_PORT,
    "--wss2-port": WSS2_PORT,
    "--position-port": POSITION_PORT,
    "--image-port": IMAGE_PORT,
}
"""The usual ports of `usarmjx serve` by the options that move them."""
# PEP 508: a name, extras in brackets, versions, and a marker behind a semicolon.
REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?([^;]*)(?:;(.*))?")
EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)")
USERS_EXTRAS = ("cuda", "rl", "train", "warp")
SHOWN = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "viser")
"""Packages whose versions are listed."""


@dataclass(frozen=True)
class Finding:
    """Finding about one thing.

    Attributes:
        about: Which thing.
        verdict: State: fine, worth knowing, or wrong.
        text: Finding.
        advice: Remedy, if any.
    """

    about: str
    verdict: Verdict
    text: str
    advice: str = ""


Check = Callable[[], Iterator[Finding]]
"""Looks at something."""


def version_of(package: str) -> str | None:
    """Return the version of an installed package, or None."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_versions() -> Iterator[Finding]:
    """Look whether Python and all packages are there; say which extras are."""
    python = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < OLDEST_PYTHON:
        yield Finding("python", "wrong", f"Python {python}", "usarmjx needs Python 3.11 or newer")
    else:
        yield Finding("python", "ok", f"Python {python} on {platform.system()} {platform.machine()}")
    found = {name: version_of(name) for name in SHOWN}
    shown = ", ".join(f"{name} {version}" for name, version in found.items() if version)
    yield Finding("packages", "ok", f"usarmjx {usarmjx.__version__}, {shown}")
    needed, extras = requirements()
    missing = [name for name in needed if version_of(name) is None]
    if missing:
        advice = f"pip install {' '.join(missing)}; or install usarmjx again"
        yield Finding("packages", "wrong", f"missing: {', '.join(missing)}", advice)
    there = [extra for extra, names in extras.items() if all(version_of(name) for name in names)]
    absent = [extra for extra in extras if extra not in there]
    text = f"extras installed: {', '.join(there) or 'none'}"
    yield Finding("extras", "ok", text + (f"; not: {', '.join(absent)}" if absent else ""))


def requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Return the packages that usarmjx needs, and those of each extra for users."""
    try:
        lines = importlib.metadata.requires("usarmjx") or []
    # A source tree that is not installed has no metadata to read.
    except importlib.metadata.PackageNotFoundError:
        lines = []
    needed: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in lines:
        found = REQUIREMENT.match(line)
        if found is None:
            continue
        extra = EXTRA.search(found[3] or "")
        if extra is None:
            needed.append(found[1])
        elif extra[1] in USERS_EXTRAS:
            # jax[cuda13] is there when its plugin is.
            name = "jax-cuda13-plugin" if "cuda13" in line else found[1]
            extras.setdefault(extra[1], []).append(name)
    return needed, extras


def check_devices() -> Iterator[Finding]:
    """Look at what JAX computes on, and whether a GPU lies idle."""
    try:
        import jax

        # The first call starts the backends, and raises if one of them fails.
        devices = jax.devices()
    except (ImportError, RuntimeError) as error:
        yield Finding("devices", "wrong", f"JAX does not start: {quoted(error)}", "install jax again")
        return
    kinds = ", ".join(sorted({f"{one.platform} ({one.device_kind})" for one in devices}))
    yield Finding("devices", "ok", f"JAX computes on {len(devices)}: {kinds}; {process.cores()} cores")
    if has_nvidia() and all(one.platform != "gpu" for one in devices):
        advice = f"{install_command('cuda')}, or unset JAX_PLATFORMS if that says cpu"
        yield Finding("devices", "note", "there is an NVIDIA GPU that JAX does not use", advice)


def has_nvidia() -> bool:
    """Return whether there is an NVIDIA GPU's driver."""
    # The driver, not JAX: an installation of JAX without CUDA sees no GPU at all.
    return shutil.which("nvidia-smi") is not None or Path("/proc/driver/nvidia/version").exists()


def check_engines() -> Iterator[Finding]:
    """Say which engine `auto` takes, and why."""
    from usarmjx.engines import choose_engine

    chosen = tuple(choose_engine("auto", purpose) for purpose in ("serve", "train", "batch"))
    if chosen[0] == "warp":
        why = "an NVIDIA GPU and Warp are there"
    elif importlib.util.find_spec("warp") is None:
        why = "without Warp a GPU's engine cannot run, and c serves one world fastest on a CPU"
    else:
        why = "JAX has no NVIDIA GPU here, and c serves one world fastest on a CPU"
    serve, train, batch = chosen
    yield Finding("engines", "ok", f"auto is {serve} to serve, {train} to train, {batch} for batches: {why}")


def check_cache(environment: Mapping[str, str] = os.environ) -> Iterator[Finding]:
    """Look whether what is compiled is kept, where, and how large that is."""
    folder = cache_folder(dict(environment))
    if folder is None:
        advice = f"unset {CACHE_VARIABLE} so that the next start compiles nothing"
        yield Finding("cache", "note", f"compilations are not kept: {CACHE_VARIABLE} says so", advice)
        return
    # Turned on as by any command: only that shows whether the folder can be written.
    complaint = enable_compilation_cache(dict(environment))
    if complaint:
        yield Finding("cache", "wrong", complaint, f"free the disk or set {CACHE_VARIABLE} to another folder")
        return
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    yield Finding("cache", "ok", f"{folder}, {size / 1e6:.0f} MB of compiled programs")


def check_threads() -> Iterator[Finding]:
    """Look whether JAX's pool of threads is safe from a deadlock."""
    try:
        process.check_pool_size()
    except UsarmjxError as error:
        yield Finding("threads", "wrong", str(error), f"set NPROC={process.MIN_THREADS}")
        return
    asked = os.environ.get("NPROC")
    text = f"NPROC={asked}" if asked else f"{process.cores()} cores"
    yield Finding("threads", "ok", f"JAX's pool is large enough: {text}")


def check_ports(ports: Mapping[str, int] = PORTS, viewer: int = VIEWER_PORT) -> Iterator[Finding]:
    """Look whether the usual ports are free."""
    taken = {option: port for option, port in ports.items() if not is_free(port)}
    for option, port in taken.items():
        advice = f"end the program that listens there, or {option} PORT, or --port-offset 100 for all ports"
        yield Finding("ports", "wrong", f"{port} is taken", advice)
    if not taken:
        yield Finding("ports", "ok", f"{', '.join(map(str, ports.values()))} are free")
    if is_free(viewer):
        yield Finding("ports", "ok", f"{viewer} is free for the live page")
    else:
        yield Finding("ports", "note", f"{viewer} is taken: the live page gets another port, and says so")


def is_free(port: int) -> bool:
    """Return whether one can listen at a port of this machine."""
    try:
        # By binding, not by connecting: a program may listen without accepting.
        bound_socket(HOST, port).close()
    except UsarmjxError:
        return False
    return True


def run_checks(checks: Sequence[Check]) -> list[Finding]:
    """Return the findings of checks; a check that fails is a finding itself."""
    found: list[Finding] = []
    for check in checks:
        try:
            found += check()
        except Exception as error:  # whatever is broken, the others are still looked at
            about = check.__name__.removeprefix("check_").removeprefix("try_")
            found.append(Finding(about, "wrong", f"{type(error).__name__}: {quoted(error)}"))
    return found


CHECKS: tuple[Check, ...] = (
    check_versions,
    check_threads,
    check_cache,
    check_ports,
    check_devices,
    check_engines,
)


ROBOT, WORLDS, STEPS = "P2AT", 2, 60
REPORT_LIMIT = 30.0
"""Time for a robot to report [s]."""
REINSTALL = "`pip check` may tell which packages do not fit; install usarmjx in an environment of its own"
RADIUS, HEIGHT = 0.2, 0.1
"""Of the ball, and how far it falls [m]; in `STEPS` control steps of 10 ms it has come to rest."""
SUNK = 0.01
"""A ball that lies on the floor is no further from where it touches it [m]."""
WALL_DISTANCE, SCANNER_REACH = 3.0, 0.4
"""Of a wall from where the robot starts, and how far before the robot's middle its scanner may be [m]."""
SPEED_WORLDS, SPEED_ROBOTS, SPEED_SECONDS = 4, 4, 1.0
"""Batch whose speed is measured, and for how long [s]."""
WHEEL_SPEED, DISTANCE = 2.0, 0.05
"""Commanded speed of the wheels [rad/s], and the distance that the robot covers [m]."""


def try_c() -> Iterator[Finding]:
    """Step a batch on engine `c`."""
    yield from _step("c")


def try_jax() -> Iterator[Finding]:
    """Step a batch on engine `jax`."""
    yield from _step("jax")


def _step(engine: str) -> Iterator[Finding]:
    """Let a ball fall on the floor of each world of a small batch."""
    import numpy as np

    from usarmjx.models.compile.physics import Physics
    from usarmjx.sim.batch import Batch
    from usarmjx.sim.scene import build_scene

    began = time.perf_counter()
    # The code of MJX for boxes, or for an elliptic cone, takes as long to compile as all the rest.
    physics = Physics(timestep=0.01, substeps=1, cone="pyramidal")
    batch = Batch(build_scene(_room(), [_ball()], physics), worlds=WORLDS, engine=engine)
    state = batch.reset()
    for _ in range(STEPS):
        state = batch.step(state)
    heights = np.asarray(batch.physics(state).qpos)[:, 2]
    took = f"{time.perf_counter() - began:.1f} s"
    if not (np.abs(heights - RADIUS) < SUNK).all():  # nor if it is not a number
        text = (
            f"a ball of radius {RADIUS} m fell on the floor and is {np.round(heights, 3).tolist()} m above it"
        )
        yield Finding(f"engine {engine}", "wrong", text, REINSTALL)
        return
    yield Finding(f"engine {engine}", "ok", f"{WORLDS} worlds made {STEPS} steps, {took} with compilation")


def _room(*shapes: "Shape") -> "ArenaSpec":
    """Return a floor, and what else is to be there."""
    from usarmjx.models.types.arena import ArenaSpec, StartPose

    start = StartPose(tag="Start", at=(0.0, 0.0, RADIUS + HEIGHT))
    return ArenaSpec(name="Room", shapes=shapes, starts=(start,), extent=((-2.0, 4.0), (-2.0, 2.0)))


def _ball() -> "RobotSpec":
    """Return a ball, which nothing drives."""
    from usarmjx.models.drives import NoDrive
    from usarmjx.models.types.robot import RobotSpec
    from usarmjx.models.types.shapes import Shape

    return RobotSpec(
        name="Ball",
        dimensions=(2 * RADIUS, 2 * RADIUS, 2 * RADIUS),
        mass=1.0,
        origin_height=RADIUS,
        chassis=(Shape(kind="sphere", size=(RADIUS,), mass=1.0),),
        drive=NoDrive(),
        sources=(("all", "chosen"),),
    )


def try_client() -> Iterator[Finding]:
    """Serve a world, let a client drive a robot in it, and cast rays."""
    from usarmjx.client.usarsim_client import UsarsimClient
    from usarmjx.models.types.shapes import Shape
    from usarmjx.server.runtime.background import serve

    began = time.perf_counter()
    thickness = 0.1
    where = (WALL_DISTANCE + thickness, 0.0, 0.5)
    wall = Shape(kind="box", size=(thickness, 2.0, 0.5), at=where, surface="wall")
    with (
        contextlib.redirect_stdout(io.StringIO()),  # of what a server says
        # A free port and no waiting for the clock: servers of the user may run beside this one.
        serve(_room(wall), port=0, host=HOST, realtime_factor=0.0) as served,
        UsarsimClient(HOST, served.port, timeout=REPORT_LIMIT) as client,
    ):
        _, at, turn = client.start_poses()[0]
        client.init(f"USARBot.{ROBOT}", "Patient", at, turn)
        way = _drive(client)
        # Else the robot goes on towards the wall while the scan below is taken.
        client.drive(0.0, 0.0)
        # The wall stands across the way, so its nearest point lies straight ahead.
        nearest = min(_next(client, "RangeScanner").scan())
    took = f"{time.perf_counter() - began:.1f} s"
    yield Finding(
        "client", "ok" if way >= DISTANCE else "wrong", f"a client drove its {ROBOT} {way:.2f} m, {took}"
    )
    # The scanner stands ahead of the robot's middle, from which the way is measured.
    fine = 0.0 < WALL_DISTANCE - way - nearest < SCANNER_REACH
    text = f"a wall {WALL_DISTANCE - way:.2f} m from the robot is {nearest:.2f} m from its scanner"
    yield Finding("rays", "ok" if fine else "wrong", text, "" if fine else REINSTALL)


def _drive(client: "UsarsimClient") -> float:
    """Drive a robot ahead; return how far it has come [m], by its reports of where it truly is."""
    client.drive(left=WHEEL_SPEED, right=WHEEL_SPEED)
    way, begun = 0.0, None
    # A robot that stands still reports for ever: the client's limit for one message would never end this.
    deadline = time.monotonic() + REPORT_LIMIT
    while way < DISTANCE and time.monotonic() < deadline:
        x, y, _ = _next(client, "GroundTruth").pose()
        # The first report, not the start pose: the robot has sunk onto its wheels since.
        begun = begun or (x, y)
        way = math.dist(begun, (x, y))
    return way


def _next(client: "UsarsimClient", kind: str) -> "ServerMessage":
    """Return the next message of a type of sensors.

    Raises:
        TimeoutError: There is none.
    """
    for message in client:
        if message.value("Type") == kind:
            return message
    raise TimeoutError(f"no report of {kind} in {client.timeout:.0f} s")


def try_speed() -> Iterator[Finding]:
    """Measure the speed of physics on engine `c`."""
    import numpy as np

    from usarmjx.engines.base import Inputs
    from usarmjx.sim.batch import engine_of
    from usarmjx.sim.scene import build_scene, start_height

    scene = build_scene("yellow", [ROBOT] * SPEED_ROBOTS)
    engine, (group,) = engine_of(scene, "c", SPEED_WORLDS), scene.groups
    model, qpos = engine.model, engine.model.qpos0.copy()
    for slot, address in zip(group.slots, group.root_qposadr, strict=True):
        start = scene.arena.starts[int(slot)]
        qpos[address[:3]] = (*start.at[:2], start_height(scene.arena, start, group.robot))
    everywhere = np.tile(qpos, (SPEED_WORLDS, 1))
    inputs = Inputs(
        ctrl=np.full((SPEED_WORLDS, model.nu), WHEEL_SPEED),
        act=np.zeros((SPEED_WORLDS, model.na)),
        xfrc_applied=np.zeros((SPEED_WORLDS, model.nbody, 6)),
        pinned=np.zeros((SPEED_WORLDS, model.nq), bool),
        pinned_dof=np.zeros((SPEED_WORLDS, model.nv), bool),
        qpos=everywhere,
    )
    # Outside of the measured time: the first reset also builds the engine's worlds.
    state, steps = engine.reset(engine.start(), np.ones(SPEED_WORLDS, bool), everywhere), 0
    began = time.perf_counter()
    while (took := time.perf_counter() - began) < SPEED_SECONDS:
        state = engine.advance(state, inputs)
        steps += 1
    period, batch = scene.physics.period, f"{SPEED_WORLDS} worlds x {SPEED_ROBOTS} {ROBOT}"
    robots = steps * SPEED_WORLDS * SPEED_ROBOTS * period / took
    text = f"engine c makes {steps / took:,.0f} steps/s of {1e3 * period:.0f} ms in {batch}"
    yield Finding("speed", "ok", f"{text}: physics of {robots:,.0f} robots in real time")


SELF_TEST: tuple[Check, ...] = (try_c, try_jax, try_client, try_speed)


COLOURS = {"ok": typer.colors.GREEN, "note": typer.colors.YELLOW, "wrong": typer.colors.RED}


def doctor(
    json: JsonFlag = False,
    self_test: Annotated[
        bool, typer.Option(help="Step small worlds and serve a client, too: ten seconds.")
    ] = True,
) -> None:
    """Check versions, devices, caches, ports, engines and small worlds; exit code 1 if one is wrong."""
    with ErrorExit():
        # Small worlds make a few steps only: nearly all of their time is compilation.
        announce("looking at packages, cache, ports and devices ...", quickly=True)
        found = run_checks(CHECKS)
        if self_test:
            for check in SELF_TEST:
                say(f"{(check.__doc__ or '').rstrip('.').lower()} ...")
                found += run_checks([check])
        faults = sum(one.verdict == "wrong" for one in found)
        if json:
            whole = {"ok": not faults, "findings": [asdict(one) for one in found]}
            typer.echo(json_format.dumps(whole, indent=1))
        else:
            show_findings(found)
        # At the end Python would look through all that was imported and compiled: a second or two.
        gc.freeze()
        if faults:
            raise typer.Exit(1)


def show_findings(found: "Sequence[Finding]") -> None:
    """Print a line for each finding, what to do below it, and the sum of it all."""
    width = max(len(one.about) for one in found)
    for one in found:
        verdict = typer.style(f"{one.verdict:5}", fg=COLOURS[one.verdict])
        typer.echo(f"{verdict}  {one.about:{width}}  {one.text}")
        if one.advice:
            typer.echo(f"{'':{width + 9}}-> {one.advice}")
    faults = [one.about for one in found if one.verdict == "wrong"]
    typer.echo(f"wrong: {', '.join(dict.fromkeys(faults))}" if faults else "nothing is wrong")
