"""Controls of served worlds for users of the page: requests of any thread, carried out between two steps."""

import asyncio
import ipaddress
import logging
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.standing import standing_height
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.spawning import spawn_from_init
from usarmjx.server.network.access import AccessRules
from usarmjx.server.protocol import commands as wire
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.runtime.loop import StepClock, StepMeter
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.scene import START_ELEVATION
from usarmjx.view.controls import BY_CLIENT, BY_PAGE, BY_POLICY, ControlLock, StartPoseChoice, WorldStatus

log = logging.getLogger(__name__)

HOLD_TIME = 0.5
"""Time after the last DRIVE of the page at which a robot stops [s]."""
MAX_NAME = 40
"""Longest name of a robot that the page spawns [characters]."""
MAX_WAITING = 64
"""Most waiting requests; a request that sets the same thing again replaces the one before."""
MAX_AT_ONCE = 4
"""Most requests that are carried out after one control step; none follows a slow one."""
MAX_ERROR = 300
"""Longest reason of a failure that is shown [characters]."""


@dataclass(eq=False)
class HeldRobot:
    """A robot that the page drives.

    Attributes:
        client: Dialogue that carries out its commands.
        own: Whether the page spawned it, rather than a client.
        stops_at: Time at which it stops unless driven again [s]; infinite while it stands.
    """

    client: Client
    own: bool
    stops_at: float = math.inf


class PageRobots:
    """Robots of a world that the page drives; only for the thread that runs the world.

    Args:
        server: The world's server.
    """

    def __init__(self, server: BotServer) -> None:
        self._server, self._world = server, server.world
        self._held: dict[int, HeldRobot] = {}

    def tick(self, now: float) -> None:
        """Stop robots that were not driven again in time; forget those that are gone."""
        for slot, held in list(self._held.items()):
            if held.client.robot is None or held.client.lost:
                self._forget(slot)
            elif now >= held.stops_at:
                self._stop(held)

    def drivers(self) -> dict[int, str]:
        """Return the driver of each robot, by slot."""
        # Later entries win: the page over a client, a client over the policy.
        found = dict.fromkeys(self._world.agents().values(), BY_POLICY)
        # Lists first: other threads read this while robots come and go.
        found |= dict.fromkeys(list(self._world.robots), BY_CLIENT)
        return found | dict.fromkeys(list(self._held), BY_PAGE)

    def taken_over(self) -> frozenset[int]:
        """Return the slots of the robots that the page drives and did not spawn."""
        return frozenset(slot for slot, held in list(self._held.items()) if not held.own)

    def take_over(self, slot: int) -> None:
        """Take over a robot that a client or a policy drives.

        Raises:
            UsageError: There is none.
        """
        if slot in self._held:
            return
        robot = self._world.robots.get(slot)
        client = Client(self._world, "the page")
        if robot is None:
            agents = {agent: name for name, agent in self._world.agents().items()}
            if slot not in agents:
                raise UsageError(f"there is no robot {slot} to take over")
            group, _ = self._world.scene.group_of(slot)
            spec = self._world.scene.groups[group].robot
            # By the name of the policy's robot: the world hands it over as it stands, and this pose is not
            # used.
            client.attach_robot(self._world.spawn(spec, agents[slot], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
            self._server.guests.append(client)
        else:
            # The client keeps its robot and its reports; only its commands are ignored.
            client.robot, robot.controller = robot, client
        self._held[slot] = HeldRobot(client, own=False)
        log.info("the page has taken over %s", self._name(slot))

    def give_back(self, slot: int) -> None:
        """Return a robot that was taken over to its client or policy."""
        held = self._held.get(slot)
        if held is not None and not held.own:
            # Stopped first: its client or policy may send no command for a while.
            self._stop(held)
            self._forget(slot)

    def release_all(self) -> None:
        """Stop all robots, and give back those that were taken over."""
        for slot, held in list(self._held.items()):
            self._stop(held)
            self.give_back(slot)

    def drive(self, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of DRIVE; without another call in time all are 0 again."""
        held = self._held_robot(slot)
        self._execute(held, wire.DriveRobot(tuple(values.items())))
        # A page that freezes or loses its connection sends no more: its robot stops by itself.
        held.stops_at = time.monotonic() + HOLD_TIME if any(values.values()) else math.inf

    def set_joint(self, slot: int, joint: str, position: float) -> None:
        """Move a joint to a position [rad or m]."""
        self._execute(self._held_robot(slot), wire.MultiDrive(((joint, position),)))

    def set_light(self, slot: int, on: bool) -> None:
        """Switch a headlight."""
        self._execute(self._held_robot(slot), wire.DriveRobot((), light=on))

    def zoom(self, slot: int, camera: str, fov: float) -> None:
        """Set a camera's field of view [rad]."""
        self._execute(self._held_robot(slot), wire.SetFov(((camera, fov),)))

    def operate(self, slot: int, effecter: str, opcode: str, value: float | None) -> None:
        """Operate an effecter of a robot, as SET does."""
        held = self._held_robot(slot)
        robot = self._robot(held)
        kinds = [one.mount.kind for one in robot.effecters if one.mount.name == effecter]
        if not kinds:
            raise UsageError(f"{robot.name} has no effecter {effecter}")
        params = "" if value is None else f"{value:g}"
        self._execute(held, wire.Set(kinds[0], effecter, opcode, params))

    def spawn(self, spec: RobotSpec, name: str, pos: Vec3, yaw: float) -> None:
        """Spawn a robot that has no client; see `WorldControls.spawn`."""
        name = name.strip()
        self._check_name(name)
        # The page means the ground below the robot, INIT the origin of its chassis.
        origin = (*pos[:2], pos[2] + standing_height(spec))
        init = wire.Init(spec.name, name, flip_wire_vector(origin), flip_wire_angles((0.0, 0.0, yaw)))
        robot = spawn_from_init(self._world, init, spec)
        client = Client(self._world, "the page")
        client.attach_robot(robot, robot.spawn_time)
        self._server.guests.append(client)
        self._held[robot.slot] = HeldRobot(client, own=True)
        log.info("the page: spawned %s as %r", spec.name, robot.name)

    def remove(self, slot: int, any_owner: bool) -> None:
        """Remove a robot from the world: one that the page spawned, or anyone's.

        Raises:
            UsageError: There is none, or it is a client's.
        """
        robot, held = self._world.robots.get(slot), self._held.get(slot)
        if robot is None:
            raise UsageError(f"there is no robot {slot} that could leave")
        if not (any_owner or (held and held.own)):
            raise UsageError(f"{robot.name} is a client's: it leaves only if that is confirmed")
        if held is not None:
            self._forget(slot)
        self._world.remove(robot)

    def _check_name(self, name: str) -> None:
        """Refuse a name that cannot stand in a line."""
        if len(name) > MAX_NAME or not name.isprintable() or any(c in "{} " for c in name):
            raise UsageError(f"a robot's name has up to {MAX_NAME} characters, and no spaces or braces")

    def _held_robot(self, slot: int) -> HeldRobot:
        held = self._held.get(slot)
        if held is not None and held.client.robot is not None and not held.client.lost:
            return held
        raise UsageError(f"{self._name(slot)} has a driver: take it over first")

    @staticmethod
    def _robot(held: HeldRobot) -> Robot:
        if held.client.robot is None:
            raise UsageError("the robot has gone")
        return held.client.robot

    def _execute(self, held: HeldRobot, command: wire.Command) -> None:
        """Carry out a command.

        Raises:
            UsageError: The command failed, for the reasons of its log.
        """
        session = held.client.session
        held.client.handle(command)
        # Taken out every time, though mostly unused: nobody else empties this dialogue.
        answer = session.data_to_send().decode("latin-1")
        faults = session.take_faults()
        if faults:
            raise UsageError("; ".join(faults))
        if isinstance(command, wire.Set) and "{Status Failed}" in answer:
            raise UsageError(f"{self._robot(held).name} cannot do {command.opcode} of {command.name} now")

    def _stop(self, held: HeldRobot) -> None:
        held.stops_at = math.inf
        robot = held.client.robot
        if robot is not None and not held.client.lost:
            self._execute(held, wire.DriveRobot(tuple((key, 0.0) for key in robot.spec.drive.keys)))

    def _forget(self, slot: int) -> None:
        client = self._held.pop(slot).client
        # Detached first: the dialogue must not remove the robot when it is dropped.
        robot, client.robot = client.robot, None
        if client in self._server.guests:
            self._server.guests.remove(client)
            if robot is not None and self._world.agents() and self._world.robots.get(slot) is robot:
                self._world.remove(robot)  # its policy has it again
        if robot is not None and robot.controller is client:
            robot.controller = None

    def _name(self, slot: int) -> str:
        robot = self._world.robots.get(slot)
        return f"robot {slot}" if robot is None else robot.name


def control_lock(address: str, rules: AccessRules, wanted: bool = False) -> ControlLock:
    """Return the lock of a page's controls.

    Users can take it where only this machine can open the page, or only peers with the token; elsewhere only
    if the operator wants that.

    Args:
        address: IP address that the page is listened on.
        rules: Rules of access.
        wanted: Whether every user of the page may have its controls.
    """
    is_loopback = ipaddress.ip_address(address.partition("%")[0]).is_loopback
    return ControlLock(allowed=wanted or is_loopback or bool(rules.token))


@dataclass(frozen=True)
class _Request:
    """Request of a user.

    Attributes:
        world: Number of its world.
        act: Carries it out.
        takes_long: Whether it takes as long as a control step or longer.
    """

    world: int
    act: Callable[[], None]
    takes_long: bool = False


class ServedControls:
    """The `view.controls.WorldControls` of served worlds; a `gamebots.server.Service` of the first one.

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
        """Robot classes that can be spawned; in a batch only those of its roster have room."""
        return sorted(ROBOTS.names(), key=str.lower)

    # A service

    async def start(self) -> list[str]:
        """Do nothing: there is no port to open."""
        return []

    def tick(self) -> None:
        """Carry out waiting requests."""
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
            # Outside the lock: carrying it out may add requests.
            self._guarded(request.world, request.act)
            # The next request waits for the next step: two slow ones would delay the reports of all clients.
            if request.takes_long:
                return

    def stop(self) -> None:
        """Cancel unfinished requests."""
        for task in self._tasks:
            task.cancel()

    # For any thread

    def status(self, world: int) -> WorldStatus:
        """Return the status of a world."""
        server, (errors, last) = self._servers[world], self._errors.get(world, (0, ""))
        recovery_log, robots = server.world.recovery_log, self._robots[world]
        return WorldStatus(
            time=server.world.time,
            realtime_factor=self._meters[world].realtime_factor(time.perf_counter()),
            paused=self._clock.paused,
            speed=self._clock.factor,
            connections=len(server.clients),
            bad_worlds=recovery_log.resets,
            put_back=recovery_log.put_back,
            put_back_names=recovery_log.names,
            errors=errors,
            last_error=last,
            drivers=robots.drivers(),
            taken_over=robots.taken_over(),
        )

    def starts(self, world: int) -> Sequence[StartPoseChoice]:
        """Return the start poses of a world's arena."""
        arena = self._servers[world].world.arena
        # Start poses have one standard elevation (manual 5.3.4); the page means the ground below.
        return [
            StartPoseChoice(
                start.tag, (*start.at[:2], arena.floor + start.at[2] - START_ELEVATION), start.yaw
            )
            for start in arena.starts
        ]

    def pause(self, on: bool) -> None:
        """Pause all worlds, or let them go on."""
        self._clock.pause(on)

    def step(self, steps: int = 1) -> None:
        """Make some control steps in all worlds, and pause them."""
        # All worlds have one clock: what it refuses is shown with the first world.
        self._guarded(0, partial(self._clock.step, steps))

    def set_speed(self, factor: float) -> None:
        """Set the simulated seconds per second; 0: as many as possible."""
        self._guarded(0, partial(self._clock.set_factor, factor))

    def reset(self, world: int) -> None:
        """Restart a world."""
        self._enqueue(world, "reset", partial(self._begin, world, partial(self._reset, world)))

    def take_over(self, world: int, slot: int, on: bool = True) -> None:
        """Take over a robot that a client or a policy drives, or give it back."""
        robots = self._robots[world]
        act = partial(robots.take_over if on else robots.give_back, slot)
        self._enqueue(world, ("take over", slot), act, takes_long=True)

    def drive(self, world: int, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of a robot's DRIVE for half a second."""
        # A copy of the values: the page may change its own before the request has its turn.
        self._enqueue(world, ("drive", slot), partial(self._robots[world].drive, slot, dict(values)))

    def set_joint(self, world: int, slot: int, joint: str, position: float) -> None:
        """Move a joint to a position [rad or m]."""
        self._enqueue(world, (slot, joint), partial(self._robots[world].set_joint, slot, joint, position))

    def set_light(self, world: int, slot: int, on: bool) -> None:
        """Switch a robot's headlight."""
        self._enqueue(world, ("light", slot), partial(self._robots[world].set_light, slot, on))

    def zoom(self, world: int, slot: int, camera: str, fov: float) -> None:
        """Set the field of view of a robot's camera [rad]."""
        self._enqueue(world, ("zoom", slot, camera), partial(self._robots[world].zoom, slot, camera, fov))

    def operate(self, world: int, slot: int, effecter: str, opcode: str, value: float | None = None) -> None:
        """Operate an effecter of a robot, as SET does."""
        act = partial(self._robots[world].operate, slot, effecter, opcode, value)
        self._enqueue(world, ("operate", slot, effecter), act)

    def spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        """Spawn a robot of a class with no client."""
        # The key is a new object: two spawns never replace each other.
        appearing = partial(self._spawn, world, robot, name, pos, yaw)
        self._enqueue(world, object(), partial(self._begin, world, appearing))

    def remove(self, world: int, slot: int, any_owner: bool = False) -> None:
        """Remove a robot from the world: one that the page spawned, or anyone's."""
        act = partial(self._robots[world].remove, slot, any_owner)
        self._enqueue(world, ("remove", slot), act, takes_long=True)

    def release_all(self) -> None:
        """Stop all robots that the page drives, and give back what it took over."""
        for world, robots in enumerate(self._robots):
            # Stopping robots must not fail because the queue is full.
            self._enqueue(world, "let go", robots.release_all, always=True)

    # Helpers, of which the requests' own code runs in the thread of the worlds

    def _enqueue(
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
                # An OrderedDict keeps the position of a replaced key: dragging a slider does not postpone
                # its request.
                self._requests[key] = _Request(world, act, takes_long)
                return
        self._fail(world, f"too much was asked for at once: {MAX_WAITING} requests wait already")

    def _fail(self, world: int, reason: str) -> None:
        with self._lock:
            # Requests fail in the users' threads and in that of the worlds: no failure may be lost in the
            # count.
            count, _ = self._errors.get(world, (0, ""))
            self._errors[world] = count + 1, reason[:MAX_ERROR]

    def _guarded(self, world: int, act: Callable[[], None]) -> None:
        try:
            act()
        except UsarmjxError as error:
            self._fail(world, str(error))

    def _begin(self, world: int, work: Callable[[], Coroutine[None, None, None]]) -> None:
        """Start a request whose first part runs in another thread."""

        async def run() -> None:
            try:
                await work()
            except UsarmjxError as error:
                self._fail(world, str(error))

        task = asyncio.get_running_loop().create_task(run())
        # asyncio keeps only weak references: without this one the task could vanish before it ends.
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reset(self, world: int) -> None:
        served, robots = self._servers[world].world, self._robots[world]
        # In a thread: the first reset compiles, and all worlds step on meanwhile.
        await asyncio.get_running_loop().run_in_executor(None, served.prepare_reset)

        def act() -> None:
            robots.release_all()
            served.reset()

        # Queued again: after the wait this must run between two steps, like all requests.
        self._enqueue(world, "reset now", act, takes_long=True)

    async def _spawn(self, world: int, robot: str, name: str, pos: Vec3, yaw: float) -> None:
        robots = self._robots[world]
        spec = ROBOTS.get(robot)
        # Before it is queued: the first robot of a class may take seconds, in which the worlds must step on.
        await self._servers[world].prepare(spec)
        self._enqueue(world, object(), partial(robots.spawn, spec, name, pos, yaw), takes_long=True)
