"""Source of the live page's frames: served worlds, drawn as they are now."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.server.worlds.policy_world import PolicyWorld
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.ray_geometry import victims_of
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, Frame
from usarmjx.view.scoreboard import BoardFacts

LINK_PERIOD = 0.5
"""Interval between two computations of links in a world without a radio of its own [s of its time]."""


@dataclass
class _CachedDrawing:
    """Drawing of a world with its key, and the last links."""

    key: tuple[object, ...]
    capture: Capture
    drawing: Drawing
    links: Links | None = None
    links_due: float = 0.0


class ServedSource:
    """A `FrameSource` of served worlds; only for the thread that runs them.

    Args:
        worlds: The worlds, in the order of their numbers.
        radio: Constants of the wireless server's radio; None: links are shown only where a world has a radio
            of its own.
    """

    def __init__(self, worlds: Sequence[ServedWorld], radio: RadioSettings | None = None) -> None:
        self._worlds, self._radio = worlds, radio
        self._cached: dict[int, _CachedDrawing] = {}

    @property
    def num_worlds(self) -> int:
        """Number of served worlds."""
        return len(self._worlds)

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: a new one when a robot has joined or left, or with another arena."""
        return self._refresh(world).drawing

    def frame(self, world: int) -> Frame:
        """Return the present frame of a world."""
        cached, served = self._refresh(world), self._worlds[world]
        frame = cached.capture.frame(*served.one_world())
        return replace(
            frame,
            links=self._links(cached, served, frame),
            trace=served.traces.sketch(),
            score=served.score if isinstance(served, PolicyWorld) else None,
            extra=_maps(cached.drawing, served) if isinstance(served, PolicyWorld) else {},
        )

    def board_facts(self, world: int) -> BoardFacts:
        """Return a world's facts for the scoreboard."""
        served = self._worlds[world]
        state, _ = served.one_world()
        owners = np.asarray(victims_of(served.scene, state.arena_state).owner)
        # Negative owners are false alarms.
        victims = len(np.unique(owners[owners >= 0]))
        if not isinstance(served, PolicyWorld):
            return BoardFacts(owners=owners, victims=victims)
        task = served.policy_batch.env.name
        return BoardFacts(task=task, time_left=served.time_left, owners=owners, victims=victims)

    def _refresh(self, world: int) -> _CachedDrawing:
        served = self._worlds[world]
        state, physics = served.one_world()
        names = {slot: robot.name for slot, robot in served.robots.items()}
        # Where all worlds have the same arena an episode changes nothing that is drawn.
        episode = 0 if state.arena_state is None else int(state.episode)
        # Episode and number, too: worlds of a batch share a scene, and change arenas at resets.
        key = served.scene, tuple(names.items()), episode, int(state.number)
        if world not in self._cached or self._cached[world].key != key:
            capture = Capture(served.scene)
            self._cached[world] = _CachedDrawing(key, capture, capture.drawing(state, physics, names))
        return self._cached[world]

    def _links(self, cached: _CachedDrawing, served: ServedWorld, frame: Frame) -> Links | None:
        if self._radio is None or frame.links is not None:
            return frame.links
        # Both bounds: after a reset or another world the time may have moved backwards.
        if not 0.0 <= cached.links_due - frame.time <= LINK_PERIOD:
            cached.links, cached.links_due = served.links(self._radio), frame.time + LINK_PERIOD
        return cached.links


def _maps(drawing: Drawing, world: PolicyWorld) -> dict[str, np.ndarray]:
    """Return the maps that the robots of a task are building, in the form of `Frame.extra`."""
    maps = world.maps
    if maps is None:
        return {}
    named = {
        f"{MAP_PREFIX}{robot.name}": np.asarray(maps.squares[slot]) for slot, robot in drawing.robots.items()
    }
    return {MAP_GRID: np.array([*maps.low, maps.cell]), **named}
