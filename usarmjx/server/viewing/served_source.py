"""Served worlds as what the page and recordings look at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.server.worlds.policy_world import PolicyWorld
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, Frame

LINK_PERIOD = 0.5
"""The radio of a world that has none of its own is looked at so often [s of its time]."""


@dataclass
class _Looked:
    """What is known of a world: what it was drawn of, and its links when last looked at."""

    key: tuple[object, ...]
    capture: Capture
    drawing: Drawing
    links: Links | None = None
    links_due: float = 0.0


class ServedSource:
    """A `FrameSource` of served worlds; to be asked by the thread that runs them.

    Args:
        worlds: The worlds, in the order of their numbers.
        radio: Constants of the radio that the wireless server has; None: links are shown only where a world
            has a radio of its own.
    """

    def __init__(self, worlds: Sequence[ServedWorld], radio: RadioSettings | None = None) -> None:
        self._worlds, self._radio = worlds, radio
        self._looked: dict[int, _Looked] = {}

    @property
    def num_worlds(self) -> int:
        """How many worlds are served."""
        return len(self._worlds)

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: another one when a robot has joined or left, or with another arena."""
        return self._look(world).drawing

    def frame(self, world: int) -> Frame:
        """Return a world as it is now."""
        looked, served = self._look(world), self._worlds[world]
        frame = looked.capture.frame(*served.one_world())
        return replace(
            frame,
            links=self._links(looked, served, frame),
            trace=served.traces.sketch(),
            score=served.score if isinstance(served, PolicyWorld) else None,
            extra=_maps(looked.drawing, served) if isinstance(served, PolicyWorld) else {},
        )

    def _look(self, world: int) -> _Looked:
        served = self._worlds[world]
        state, physics = served.one_world()
        names = {slot: robot.name for slot, robot in served.robots.items()}
        episode = 0 if state.arena_state is None else int(state.episode)
        key = served.scene, tuple(names.items()), episode, int(state.number)
        if world not in self._looked or self._looked[world].key != key:
            capture = Capture(served.scene)
            self._looked[world] = _Looked(key, capture, capture.drawing(state, physics, names))
        return self._looked[world]

    def _links(self, looked: _Looked, served: ServedWorld, frame: Frame) -> Links | None:
        if self._radio is None or frame.links is not None:
            return frame.links
        if not 0.0 <= looked.links_due - frame.time <= LINK_PERIOD:
            looked.links, looked.links_due = served.links(self._radio), frame.time + LINK_PERIOD
        return looked.links


def _maps(drawing: Drawing, world: PolicyWorld) -> dict[str, np.ndarray]:
    """Return the maps that the robots of a task are building, as `Frame.extra` has them."""
    maps = world.maps
    if maps is None:
        return {}
    named = {
        f"{MAP_PREFIX}{robot.name}": np.asarray(maps.squares[slot]) for slot, robot in drawing.robots.items()
    }
    return {MAP_GRID: np.array([*maps.low, maps.cell]), **named}
