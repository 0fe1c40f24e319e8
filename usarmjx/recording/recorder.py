"""Recorder of a world: its inputs, states, readings and events become messages of a file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.engines.base import PhysicsState
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording import foxglove
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.inputs import (
    ConveyorsSet,
    Input,
    Interrupted,
    LooseAdded,
    LoosePlaced,
    LooseRemoved,
    OrdersGiven,
    RobotAdded,
    RobotPlaced,
    RobotRedescribed,
    RobotRemoved,
    StepState,
    VacuumSet,
    WorldReset,
    WorldSetup,
)
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import NOBODY, Drawing, Frame

FRAME_PERIOD = 0.2
"""Interval between two recorded frames [s of the world's time]; physics is recorded in every step."""
SensorValues = list[tuple[int, int, np.ndarray]]
"""Slots, indices of sensors in the suite, and their values."""


class WorldMessages:
    """Messages about one world.

    Args:
        number: Its number in the recording.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._key: tuple[object, ...] | None = None
        self._capture: Capture | None = None
        self._drawing: Drawing | None = None
        self._undrawn: set[int] = set()
        """Slots whose robot is another one than in the drawing, or has other sensors."""
        self._trails, self._transforms = foxglove.Trails(), foxglove.Transforms()
        self._score: float | None = None
        self._scenes, self._scene_keys = foxglove.SceneTexts(), dict[str, bytes]()

    def _channel(self, kind: str, about: str = "") -> ChannelName:
        return ChannelName(self._number, kind, about)

    def setup(self, setup: WorldSetup, at: float, file: RecordingFile) -> None:
        """Write the world's initial inputs; without its arenas if these are not usarmjx's own values."""
        try:
            file.write(self._channel("setup"), at, setup)
        except UsageError as error:
            # A recording that cannot be replayed can still be watched: the reason is kept with it.
            file.write(self._channel("setup"), at, replace(setup, arenas=(), roster=(), why_not=str(error)))

    def input(self, given: Input, at: float, file: RecordingFile) -> None:
        """Write an input of the world."""
        if isinstance(given, (RobotRemoved, RobotRedescribed)):
            self._undrawn.add(given.slot)
        try:
            file.write(self._channel("inputs"), at, given)
        except UsageError as error:
            # An input that cannot be written ends the part that can be replayed, not the recording.
            file.write(self._channel("inputs"), at, Interrupted(step=given.step, reason=str(error)))

    def state(self, state: StepState, file: RecordingFile) -> None:
        """Write the physics after a control step."""
        file.write(self._channel("states"), state.time, state)

    def event(self, fields: Mapping[str, Any], at: float, file: RecordingFile) -> None:
        """Write an event, for usarmjx and for Foxglove."""
        file.write(self._channel("events"), at, dict(fields))
        file.write(self._channel("log"), at, foxglove.log(fields["text"], fields["robot"] or "world", at))

    def lines(self, who: tuple[str, str, bool], data: bytes, at: float, file: RecordingFile) -> None:
        """Write lines of the protocol."""
        peer, robot, sent = who
        # Peers may send any bytes: the recording must survive those that are no text.
        text = data.decode("utf-8", "replace")
        file.write(self._channel("lines"), at, {"peer": peer, "robot": robot, "sent": sent, "text": text})

    def readings(self, measured: "SensorValues", at: float, file: RecordingFile) -> None:
        """Write readings of sensors; plane scans for Foxglove, too."""
        slots, sensors, values = zip(*measured, strict=True)
        fields = {"slots": slots, "sensors": sensors, "values": values}
        file.write(self._channel("readings"), at, fields)
        drawing = self._drawing
        for slot, sensor, value in measured:
            robot = None if drawing is None or slot in self._undrawn else drawing.robots.get(slot)
            if drawing is not None and robot is not None and foxglove.is_scanner(robot, sensor):
                about = f"{robot.name}/{robot.sensors[sensor].names[0]}"
                scan = foxglove.laser_scan(drawing, robot, sensor, value, at)
                file.write(self._channel("scan", about), at, scan)

    def record_frame(self, snapshot: "WorldSnapshot", at: float, file: RecordingFile) -> None:
        """Write the frame of a world, and its drawing where that has changed."""
        world, scene = snapshot.world, snapshot.scene
        episode = 0 if world.arena_state is None else int(world.episode)
        key = scene, tuple((snapshot.names or {}).items()), int(world.number), episode
        # A capture belongs to a scene; a drawing also to names and, between arenas, to the episode.
        if self._capture is None or self._key is None or self._key[0] is not scene:
            self._capture = Capture(scene)
        if self._drawing is None or self._key != key:
            self._key = key
            self._drawing = self._capture.drawing(world, snapshot.physics, snapshot.names)
            # From here on slots mean the robots of the new drawing again.
            self._undrawn.clear()
            file.write(self._channel("drawings"), at, self._drawing)
            self._write_scene(self._drawing, at, file)
        seen = self._capture.frame(world, snapshot.physics)
        links = seen.links if snapshot.links is None else snapshot.links
        frame = replace(seen, time=at, trace=snapshot.trace, score=snapshot.score, links=links)
        self._write_frame(self._drawing, frame, file)

    def _write_scene(self, drawing: Drawing, at: float, file: RecordingFile) -> None:
        """Write the shapes of robots, and those of all else where they have changed."""
        parts = {
            "": [body for body, drawn in enumerate(drawing.bodies) if drawn.slot == NOBODY],
            "robots": [body for body, drawn in enumerate(drawing.bodies) if drawn.slot != NOBODY],
        }
        for about, bodies in parts.items():
            key = self._scenes.key(drawing, bodies)
            if self._scene_keys.get(about) == key:
                continue
            self._scene_keys[about] = key
            channel = self._channel("scene", about)
            file.write_in_pieces(
                channel, self._scenes.writing(drawing, bodies, at, partial(file.write, channel, at))
            )

    def _write_frame(self, drawing: Drawing, frame: Frame, file: RecordingFile) -> None:
        at = frame.time
        file.write(self._channel("frames"), at, frame)
        file.write(self._channel("tf"), at, self._transforms.message(drawing, frame))
        names = {slot: drawing.robots[slot].name for slot in frame.robots}
        # Trails of robots that have left end, so that a new robot of that name begins its own.
        self._trails.keep(names.values())
        for slot, robot in frame.robots.items():
            name = names[slot]
            trail = self._trails.add(name, robot, at)
            if trail is not None:
                file.write(self._channel("trail", name), at, trail)
        if frame.score is not None and frame.score != self._score:
            self._score = frame.score
            file.write(self._channel("score"), at, {"score": frame.score})


@dataclass(frozen=True, eq=False)
class WorldSnapshot:
    """A world at one moment, to be drawn by another thread: nothing in it changes any more.

    Attributes:
        scene: Its scene.
        world: Its state without the physics; NumPy arrays.
        physics: Its physics; NumPy arrays.
        names: The robots' names by slot; None: those of the roster.
        trace: Points of the robots' traces.
        score: A task's score so far.
        time: Simulated time, if it is not the world's own [s].
        links: Its radio links; None: those of its state, if it has a radio of its own.
    """

    scene: Scene
    world: World
    physics: PhysicsState
    names: Mapping[int, str] | None = None
    trace: OverlayLines | None = None
    score: float | None = None
    time: float | None = None
    links: Links | None = None


@dataclass
class WorldRecorder:
    """Records one world; all methods are quick, the rest is done in the file's thread.

    Args:
        file: The recording.
        setup: The world's initial inputs.
        number: Number of the world in the recording.
        since: Time at which the world begins in the recording [s].
        radio: Constants of a server's radio that the world's robots use; None without one.

    Attributes:
        steps: Control steps made so far, since the recording began.
    """

    file: RecordingFile
    setup: WorldSetup
    number: int = 0
    since: float = 0.0
    radio: RadioSettings | None = None
    steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Record the world's initial inputs."""
        self._messages = WorldMessages(self.number)
        self._last: tuple[Any, ...] = ()
        self._known: dict[tuple[int, ...], list[np.ndarray]] = {}
        self._measured: SensorValues = []
        self._next_frame = self._time = 0.0
        self.file.put(partial(self._messages.setup, self.setup, self.since))

    def _put(self, given: Input) -> None:
        self.file.put(partial(self._messages.input, given, self.since + self._time))

    def event(self, kind: str, text: str, robot: str = "", slot: int = -1) -> None:
        """Record an event."""
        at = self.since + self._time
        fields = {"kind": kind, "robot": robot, "slot": slot, "text": text}
        self.file.put(partial(self._messages.event, fields, at))

    # Inputs of the world

    def adding(self, robot: RobotSpec, name: str, poses: Sequence[tuple[Vec3, np.ndarray]]) -> None:
        """Record the attempt to add a robot."""
        self._put(RobotAdded(step=self.steps, robot=robot, name=name, poses=tuple(poses)))

    def joined(self, slot: int, name: str, robot: str) -> None:
        """Record that a robot has joined."""
        # Commands of the slot's former robot say nothing of the new one: all are recorded again.
        self._known.clear()
        self.event("join", f"{name}, a {robot}, joins", name, slot)

    def removed(self, slot: int, name: str) -> None:
        """Record that a robot has left."""
        # Readings so far are of the robot that leaves, and come before its removal.
        self._flush_readings()
        self._put(RobotRemoved(step=self.steps, slot=slot))
        self._known.clear()
        self.event("leave", f"{name} leaves", name, slot)

    def redescribed(self, slot: int, robot: RobotSpec) -> None:
        """Record the new description of a robot."""
        self._flush_readings()
        self._put(RobotRedescribed(step=self.steps, slot=slot, robot=robot))

    def placed(self, slot: int, pos: np.ndarray, quat: np.ndarray) -> None:
        """Record the pose set for a robot."""
        self._put(RobotPlaced(step=self.steps, slot=slot, pos=pos, quat=quat))

    def adding_loose(self, thing: LooseObject, *, held: bool) -> None:
        """Record the attempt to add a loose object."""
        self._put(LooseAdded(step=self.steps, thing=thing, held=held))

    def removed_loose(self, number: int) -> None:
        """Record the removal of a loose object."""
        self._put(LooseRemoved(step=self.steps, number=number))

    def placed_loose(self, number: int, pos: np.ndarray, quat: np.ndarray) -> None:
        """Record the pose set for a loose object."""
        self._put(LoosePlaced(step=self.steps, number=number, pos=pos, quat=quat))

    def set_conveyors(self, name: str, share: float) -> None:
        """Record the speed set for conveyors."""
        self._put(ConveyorsSet(step=self.steps, name=name, share=share))

    def set_vacuum(self, slot: int, effecter: int, *, closes: bool) -> None:
        """Record the closing or opening of a vacuum."""
        self._put(VacuumSet(step=self.steps, slot=slot, effecter=effecter, closes=closes))

    def reset(self) -> None:
        """Record the restart of the world."""
        self._put(WorldReset(step=self.steps))
        self._known.clear()
        self._last = ()
        self.event("reset", "the world begins anew")

    def interrupted(self, reason: str) -> None:
        """Record a change that no replay can repeat."""
        self._put(Interrupted(step=self.steps, reason=reason))

    def record_orders(self, scene: Scene, states: Sequence[Mapping[str, Any]]) -> None:
        """Record commands that have changed since the last control step; call it before each step.

        Args:
            scene: The scene.
            states: Fields of the groups' `GroupState`s, by name; leading axis over robots.
        """
        values = tuple(value for state in states for value in state.values())
        # Unchanged PyTrees are the same objects: in most steps this spares the comparison of arrays.
        if len(values) == len(self._last) and all(a is b for a, b in zip(values, self._last, strict=True)):
            return
        self._last = values
        known, self._known = self._known, {}
        orders: dict[int, dict[str, Any]] = {}
        for group, state in zip(scene.groups, states, strict=True):
            slots = tuple(group.slots.tolist())
            leaves = self._known[slots] = [np.asarray(leaf) for leaf in jax.tree.leaves(state)]
            for member in _changed(leaves, known.get(slots), len(slots)):
                orders[slots[member]] = jax.tree.map(lambda x, i=member: np.asarray(x)[i], dict(state))
        if orders:
            self._put(OrdersGiven(step=self.steps, orders=orders))

    # Results

    def stepped(
        self, time: float, qpos: np.ndarray, qvel: np.ndarray, act: np.ndarray, steps: int = 1
    ) -> None:
        """Record the physics after control steps; the arrays are copied.

        Args:
            time: Simulated time [s].
            qpos: Positions (nq,).
            qvel: Velocities (nv,).
            act: Activations (na,).
            steps: Number of steps.
        """
        # Before the time moves on: these readings are of the state so far.
        self._flush_readings()
        self.steps, self._time = self.steps + steps, time
        state = StepState(
            step=self.steps, time=self.since + time, qpos=qpos.copy(), qvel=qvel.copy(), act=act.copy()
        )
        self.file.put(partial(self._messages.state, state))

    @property
    def frame_is_due(self) -> bool:
        """Whether the next frame is due."""
        # Times are sums of periods, with rounding errors.
        return self._time >= self._next_frame - 1e-6

    def record_frame(self, snapshot: WorldSnapshot) -> None:
        """Record a frame of the world."""
        # From the present frame on: after a pause frames do not come in a burst.
        self._next_frame = self._time + FRAME_PERIOD
        job = partial(self._messages.record_frame, snapshot, self.since + self._time)
        self.file.put(job, is_frame=True)

    def read(self, slot: int, sensor: int, value: np.ndarray) -> None:
        """Record the reading of a sensor; the value must not change any more."""
        self._measured.append((slot, sensor, value))

    def _flush_readings(self) -> None:
        if self._measured:
            self.file.put(partial(self._messages.readings, self._measured, self.since + self._time))
            self._measured = []

    def lines(self, peer: str, robot: str, data: bytes, *, sent: bool) -> None:
        """Record lines to or from a client."""
        self.file.put(partial(self._messages.lines, (peer, robot, sent), data, self.since + self._time))


def _changed(leaves: list[np.ndarray], before: list[np.ndarray] | None, count: int) -> list[int]:
    """Return the robots of which any bit has changed; all, without former values."""
    if before is None or len(before) != len(leaves):
        return [*range(count)]
    differs = np.zeros(count, bool)
    for new, old in zip(leaves, before, strict=True):
        if new is not old:
            # Bits, not values: a replay must repeat -0.0 and NaN, too.
            bits = [np.ascontiguousarray(one).view(np.uint8).reshape(count, -1) for one in (new, old)]
            differs |= (bits[0] != bits[1]).any(-1)
    return np.flatnonzero(differs).tolist()
