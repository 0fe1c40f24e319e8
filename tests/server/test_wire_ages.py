"""The wire's Time in worlds of any age: it goes on by control steps, in every message that has one."""

import re

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.test_adapter import House, heard
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION
from usarmjx.server.worlds.dynamic_world import DynamicWorld

HOURS = (1, 100, 10_000)
"""The last is 1.14 years."""
STEPS = 50
TIME = re.compile(r"^(\w+) .*?\{Time (\d+\.(\d+))\}")
CUT = 0.01 + 1e-9
"""Resolution of the shorter form of Time, rounded [s]."""


def said(hours):
    """Kinds of messages with their decimals, and their times less the age [s], of a P2AT in an old world."""
    world = DynamicWorld(FLAT, seed=1, max_robots=1)
    world.prepare(ROBOTS.get("P2AT"))
    age = round(hours * 3600 / world.period)
    inner = world._single  # an hour of its steps takes minutes
    inner.world = inner.world.replace(step=inner.world.step + np.int32(age))
    house = House(world)
    client = house.connect(f"INIT {{ClassName USARBot.P2AT}} {{Location 0,0,{-START_ELEVATION}}}")
    heard(client)
    found = []
    for _ in range(STEPS):
        house.run(1)
        found += [
            ((match[1], len(match[3])), float(match[2]))
            for line in heard(client)
            if (match := TIME.match(line))
        ]
    kinds, times = zip(*found, strict=True)
    return kinds, np.array(times) - age * world.period


@pytest.fixture(scope="module")
def young():
    return said(0)


@pytest.mark.parametrize("hours", HOURS)
def test_time_of_every_message_goes_on_as_in_a_young_world(young, hours):
    kinds, times = said(hours)
    assert kinds == young[0]
    assert {("STA", 2), ("SEN", 2), ("SEN", 4)} <= set(kinds)
    np.testing.assert_allclose(times, young[1], rtol=0, atol=CUT)
    for kind in set(kinds):
        own = times[[one == kind for one in kinds]]
        assert len(own) > 2
        assert np.diff(own).min() > -1e-6, "never back"
    stated = times[[kind == ("STA", 2) for kind in kinds]]
    assert np.diff(stated).min() > 0.1, "a report every 0.2 s"
