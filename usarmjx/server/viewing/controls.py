"""What people at the page may do to served worlds: requests of any thread, carried out between two steps."""

import asyncio
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from usarmjx.base.errors import UsarmjxError
from usarmjx.base.transforms import Vec3
from usarmjx.models.robots import ROBOTS
from usarmjx.server.clock import StepClock
from usarmjx.server.meter import StepMeter
from usarmjx.server.net import BotServer
from usarmjx.server.viewing.page_robots import PageRobots
from usarmjx.sim.scene import START_ELEVATION
from usarmjx.view.controls import StartPlace, WorldStatus

MAX_WAITING = 64
"""So many requests wait at most; one that sets the same thing again takes the place of the one before."""
MAX_AT_ONCE = 4
"""Most requests that are carried out after one control step; after one that takes long no other."""
MAX_ERROR = 300
"""Longest reason that is told [characters]."""


@dataclass(frozen=True)
class _Request:
    """What somebody asked for.

    Attributes:
        world: In which world.
        act: Does it.
        takes_long: Whether it takes as long as a control step or longer.
    """

    world: int
    act: Callable[[], None]
    takes_long: bool = False


class ServedControls:
    """The `view.controls.WorldControls` of served worlds; a `net.Service` of the first one.

    Args:
        servers: The worlds' servers, in the order of their numbers.
        clock: The worlds' clock.
    """

    reset_about = (
        "Robots go back to where they appeared, loose objects, doors and victims to where they began; "
        "batteries are full, traces are gone. Clients stay connected, and the time that they are told goes "
        "on. In a world of a batch its next episode begins; the other worlds keep every bit."
    )

    def __init__(self, servers: Sequence[BotServer], clock: StepClock) -> None:
        self._servers, self._clock = servers, clock
        self._robots = [PageRobots(server) for server in servers]
        self._meters = [StepMeter(server) for server in servers]
        self._requests: OrderedDict[object, _Request] = OrderedDict()
        self._lock = threading.Lock()
        self._errors: dict[int, tuple[int, str]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def classes(self) -> Sequence[str]:
        """Robot classes that can appear; in a batch only those of its roster have room."""
        return sorted(ROBOTS.names(), key=str.lower)

    # A service

    async def start(self) -> list[str]:
        """Begin; there is nothing to say."""
        return []

    def tick(self) -> None:
        """Carry out what was asked for."""
        now = time.perf_counter()
        for meter in self._meters:
            meter.count(now)
        for robots in self._robots:
            robots.tick(time.monotonic())
        for _ in range(MAX_AT_ONCE):
            with self._lock:
                if not self._requests:
                    return
                _, request = self._requests.popitem(last=False)
            self._guarded(request.world, request.act)
            if request.takes_long:
                return

    def stop(self) -> None:
        """Forget what waits."""
        for task in self._tasks:
            task.cancel()

    # Told by anybody

    def status(self, world: int) -> WorldStatus:
        """Return how a world goes."""
        server, (errors, last) = self._servers[world], self._errors.get(world, (0, ""))
        mishaps, robots = server.world.mishaps, self._robots[world]
        return WorldStatus(
            time=server.world.time,
            realtime_factor=self._meters[world].realtime_factor(time.perf_counter()),
            paused=self._clock.paused,
            speed=self._clock.factor,
            connections=len(server.clients),
            bad_worlds=mishaps.resets,
            put_back=mishaps.put_back,
            put_back_names=mishaps.names,
            errors=errors,
            last_error=last,
            drivers=robots.drivers(),
            taken_over=robots.taken_over(),
        )

    def starts(self, world: int) -> Sequence[StartPlace]:
        """Return the start poses of a world's arena."""
        arena = self._servers[world].world.arena
        return [
            StartPlace(start.tag, (*start.at[:2], arena.floor + start.at[2] - START_ELEVATION), start.yaw)
            for start in arena.starts
        ]

    def pause(self, on: bool) -> None:
        """Let all worlds stand still, or go on."""
        self._clock.pause(on)

    def step(self, steps: int = 1) -> None:
        """Let all worlds make so many control steps, and stand still then."""
        self._guarded(0, partial(self._clock.step, steps))

    def set_speed(self, factor: float) -> None:
        """Set how many simulated seconds a second shall have; 0: as many as there can be."""
        self._guarded(0, partial(self._clock.set_factor, factor))

    def reset(self, world: int) -> None:
        """Put a world back to its start."""
        self._ask(world, "reset", partial(self._begin, world, partial(self._reset, world)))

    def take_over(self, world: int, slot: int, on: bool = True) -> None:
        """Drive a robot that a client or a policy has, or give it back."""
        robots = self._robots[world]
        act = partial(robots.take_over if on else robots.give_back, slot)
        self._ask(world, ("take over", slot), act, takes_long=True)

    def drive(self, world: int, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of a robot's DRIVE for half a second."""
        self._ask(world, ("drive", slot), partial(self._robots[world].drive, slot, dict(values)))

    def set_joint(self, world: int, slot: int, joint: str, position: float) -> None:
        """Let a joint go to a position [rad or m]."""
        self._ask(world, (slot, joint), partial(self._robots[world].set_joint, slot, joint, position))

    def set_light(self, world: int, slot: int, on: bool) -> None:
        """Switch a robot's headlight."""
        self._ask(world, ("light", slot), partial(self._robots[world].set_light, slot, on))

    def zoom(self, world: int, slot: int, camera: str, fov: float) -> None:
        """Set the field of view of a robot's camera [rad]."""
        self._ask(world, ("zoom", slot, camera), partial(self._robots[world].zoom, slot, camera, fov))

    def operate(self, world: int, slot: int, effecter: str, opcode: str, value: float | None = None) -> None:
        """Let a robot operate an effecter, as SET does."""
        act = partial(self._robots[world].operate, slot, effecter, opcode, value)
        self._ask(world, ("operate", slot, effecter), act)

    def spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        """Let a robot of a class appear with no client."""
        appearing = partial(self._spawn, world, robot, name, pos, yaw)
        self._ask(world, object(), partial(self._begin, world, appearing))

    def remove(self, world: int, slot: int, anyones: bool = False) -> None:
        """Take a robot out of the world: one that appeared by `spawn`, or anyone's."""
        act = partial(self._robots[world].remove, slot, anyones)
        self._ask(world, ("remove", slot), act, takes_long=True)

    def let_go(self) -> None:
        """Stop all robots that the page drives, and give back what it took over."""
        for world, robots in enumerate(self._robots):
            self._ask(world, "let go", robots.let_go, always=True)

    # In the thread that runs the worlds

    def _ask(
        self,
        world: int,
        what: object,
        act: Callable[[], None],
        *,
        takes_long: bool = False,
        always: bool = False,
    ) -> None:
        with self._lock:
            key = world, what
            if key in self._requests or len(self._requests) < MAX_WAITING or always:
                self._requests[key] = _Request(world, act, takes_long)
                return
        self._fail(world, f"too much was asked for at once: {MAX_WAITING} requests wait already")

    def _fail(self, world: int, reason: str) -> None:
        with self._lock:
            count, _ = self._errors.get(world, (0, ""))
            self._errors[world] = count + 1, reason[:MAX_ERROR]

    def _guarded(self, world: int, act: Callable[[], None]) -> None:
        try:
            act()
        except UsarmjxError as error:
            self._fail(world, str(error))

    def _begin(self, world: int, work: Callable[[], Coroutine[None, None, None]]) -> None:
        """Begin what waits for another thread."""

        async def run() -> None:
            try:
                await work()
            except UsarmjxError as error:
                self._fail(world, str(error))

        task = asyncio.get_running_loop().create_task(run())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reset(self, world: int) -> None:
        served, robots = self._servers[world].world, self._robots[world]
        await asyncio.get_running_loop().run_in_executor(None, served.prepare_reset)

        def act() -> None:
            robots.let_go()
            served.reset()

        self._ask(world, "reset now", act, takes_long=True)

    async def _spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        robots = self._robots[world]
        spec = ROBOTS.get(robot)
        await self._servers[world].prepare(spec)
        self._ask(world, object(), partial(robots.spawn, spec, name, pos, yaw), takes_long=True)
