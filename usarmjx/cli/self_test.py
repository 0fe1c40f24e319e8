"""The self-test of `usarmjx doctor`: a ball falls on two engines, a client drives a robot, which scans.

What it compiles is as small as can be: a cold start is to be over in ten seconds of a processor's time.
"""

import contextlib
import io
import math
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.cli.checks import HOST, Check, Finding

if TYPE_CHECKING:
    from usarmjx.client.usarsim_client import ServerMessage, UsarsimClient
    from usarmjx.models.spec.arena import ArenaSpec
    from usarmjx.models.spec.robot import RobotSpec
    from usarmjx.models.spec.shapes import Shape

ROBOT, WORLDS, STEPS = "P2AT", 2, 60
REPORT_LIMIT = 30.0
"""How long a robot may take to report [s]."""
REINSTALL = "`pip check` may tell which packages do not fit; install usarmjx in an environment of its own"
RADIUS, HEIGHT = 0.2, 0.1
"""Of the ball, and how far it falls [m]; in `STEPS` control steps of 10 ms it has come to rest."""
SUNK = 0.01
"""A ball that lies on the floor is no further from where it touches it [m]."""
WALL_DISTANCE, SCANNER_REACH = 3.0, 0.4
"""Of a wall from where the robot starts, and how far before the robot's middle its scanner may be [m]."""
WHEEL_SPEED, DISTANCE = 2.0, 0.05
"""How fast the client turns the wheels [rad/s], and how far its robot goes [m]."""


def try_c() -> Iterator[Finding]:
    """Step a batch on engine `c`."""
    yield from _step("c")


def try_jax() -> Iterator[Finding]:
    """Step a batch on engine `jax`."""
    yield from _step("jax")


def _step(engine: str) -> Iterator[Finding]:
    """Let a ball fall on the floor of each world of a small batch."""
    from usarmjx.models.build.compose import Physics
    from usarmjx.sim.batch import Batch
    from usarmjx.sim.scene import build_scene

    began = time.perf_counter()
    # What MJX compiles for boxes, or for an elliptic cone, takes as long again as all the rest.
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
    from usarmjx.models.spec.arena import ArenaSpec, StartPose

    start = StartPose(tag="Start", at=(0.0, 0.0, RADIUS + HEIGHT))
    return ArenaSpec(name="Room", shapes=shapes, starts=(start,), extent=((-2.0, 4.0), (-2.0, 2.0)))


def _ball() -> "RobotSpec":
    """Return a ball, which nothing drives."""
    from usarmjx.models.drives import NoDrive
    from usarmjx.models.spec.robot import RobotSpec
    from usarmjx.models.spec.shapes import Shape

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
    from usarmjx.models.spec.shapes import Shape
    from usarmjx.server.background import serve

    began = time.perf_counter()
    thickness = 0.1
    where = (WALL_DISTANCE + thickness, 0.0, 0.5)
    wall = Shape(kind="box", size=(thickness, 2.0, 0.5), at=where, surface="wall")
    with (
        contextlib.redirect_stdout(io.StringIO()),  # of what a server says
        serve(_room(wall), port=0, host=HOST, realtime_factor=0.0) as served,
        UsarsimClient(HOST, served.port, timeout=REPORT_LIMIT) as client,
    ):
        _, at, turn = client.start_poses()[0]
        client.init(f"USARBot.{ROBOT}", "Patient", at, turn)
        way = _drive(client)
        client.drive(0.0, 0.0)
        nearest = min(_next(client, "RangeScanner").scan())
    took = f"{time.perf_counter() - began:.1f} s"
    yield Finding(
        "client", "ok" if way >= DISTANCE else "wrong", f"a client drove its {ROBOT} {way:.2f} m, {took}"
    )
    fine = 0.0 < WALL_DISTANCE - way - nearest < SCANNER_REACH
    text = f"a wall {WALL_DISTANCE - way:.2f} m from the robot is {nearest:.2f} m from its scanner"
    yield Finding("rays", "ok" if fine else "wrong", text, "" if fine else REINSTALL)


def _drive(client: "UsarsimClient") -> float:
    """Drive a robot ahead; return how far it has come [m], by its reports of where it truly is."""
    client.drive(left=WHEEL_SPEED, right=WHEEL_SPEED)
    way, begun = 0.0, None
    deadline = time.monotonic() + REPORT_LIMIT
    while way < DISTANCE and time.monotonic() < deadline:
        x, y, _ = _next(client, "GroundTruth").pose()
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


SELF_TEST: tuple[Check, ...] = (try_c, try_jax, try_client)
