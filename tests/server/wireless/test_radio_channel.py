"""The radio of a served world on the host: the same as the batch's, for either kind of served world."""

import math

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.radio_servers import crowded
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import antenna_positions, pair_powers, pair_slots
from usarmjx.comms.walls import arena_solids
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

STATION = ROBOTS.get("ComStation")
SETTINGS = RadioSettings()


def formula(distance, walls=0):
    """The manual's formula and defaults (manual 3.2.4) [dBm]."""
    return -49.67 - 10 * 1.09 * math.log10(distance / 2) - min(walls, 5) * 6.625


@pytest.fixture(scope="module")
def yellow():
    """The yellow arena with twelve stations all over it, low enough to be behind its walls."""
    arena = ARENAS.get("yellow")
    world = crowded(arena, "ComStation")
    for i, start in enumerate(arena.starts[:12]):
        world.spawn(STATION, f"Base{i}", (*start.at[:2], arena.floor + 0.81), (0.0, 0.0, 0.0))
    yield world
    for robot in list(world.robots.values()):
        world.remove(robot)


@pytest.mark.oracle
def test_all_pairs_in_the_yellow_arena_are_as_in_the_batch(yellow):
    """Same walls, and the same power but for single precision; 66 pairs."""
    radio, robots = RadioChannel(yellow, SETTINGS), list(yellow.robots.values())
    places = jax.numpy.stack(
        [antenna_positions(STATION, s.pos, s.quat, yellow.arena.floor) for s in map(yellow.state, robots)]
    )
    power, walls = pair_powers(SETTINGS, arena_solids(yellow.arena), places)
    pairs = [(robots[i].name, robots[j].name) for i, j in zip(*pair_slots(len(robots)), strict=True)]
    np.testing.assert_array_equal([radio.obstacles(*pair) for pair in pairs], walls)
    np.testing.assert_allclose([radio.signal_strength(*pair) for pair in pairs], power, atol=1e-3)
    np.testing.assert_allclose([radio.signal_strength(*pair[::-1]) for pair in pairs], power, atol=1e-3)


def test_links_and_places_are_asked_for_once_per_control_step(yellow, monkeypatch):
    radio, asked = RadioChannel(yellow, SETTINGS), []
    state, links = yellow.state, yellow.links
    monkeypatch.setattr(yellow, "state", lambda robot: asked.append(robot.name) or state(robot))
    monkeypatch.setattr(yellow, "links", lambda settings: asked.append("links") or links(settings))
    for _ in range(3):
        radio.signal_strength("Base0", "Base1")
        radio.present()
    assert len(asked) == len(set(asked)) == 13
    yellow.step()
    radio.signal_strength("Base0", "Base1")
    assert asked[13:] == ["links"]


def test_robots_are_found_by_name_in_any_case_and_the_first_counts(yellow):
    radio = RadioChannel(yellow, SETTINGS)
    assert radio.has_robot("bASE3")
    assert radio.signal_strength("BASE0", "base1") == radio.signal_strength("Base0", "Base1")
    assert not radio.has_robot("Base")
    assert radio.signal_strength("Base0", "Nobody") is None
    assert radio.obstacles("Nobody", "Base0") is None
    x, y = ARENAS.get("yellow").starts[20].at[:2]
    twin = yellow.spawn(STATION, "BASE0", (x, y, yellow.arena.floor + 0.81), (0.0, 0.0, 0.0))
    before = radio.signal_strength("Base0", "Base1")
    assert radio.signal_strength("BASE0", "Base1") == before, "the one in the lower slot"
    yellow.remove(twin)


def test_a_robot_has_a_good_link_to_itself(yellow):
    """The formula ends at a millimetre, so this is finite; the protocols refuse powers above 0 dBm."""
    assert RadioChannel(yellow, SETTINGS).signal_strength("Base0", "base0") == pytest.approx(
        formula(1e-3), abs=1e-3
    )


def test_obstacles_between_places_are_counted_without_robots(yellow):
    radio = RadioChannel(yellow, SETTINGS)
    floor = yellow.arena.floor
    assert radio.obstacles_between((0.0, 0.0, 50.0), (10.0, 0.0, 50.0)) == 0
    assert radio.obstacles_between((4.5, -1.9, floor + 0.5), (4.5, -1.9, floor - 0.5)) == 1, "the floor"


def test_a_batch_world_has_a_radio_too():
    """World 1 of a batch; the parked robots of the roster are not there."""
    scene = build_scene(FLAT, [RosterEntry("ComStation", parked=True)] * 3)
    world = BatchWorld(Batch(scene, 2, engine="c", seed=0), 1)
    radio = RadioChannel(world, SETTINGS)
    assert radio.present() == []
    for name, x in (("A", 0.0), ("B", 3.0)):
        world.spawn(STATION, name, (x, 0.0, 0.801), (0.0, 0.0, 0.0))
    assert radio.signal_strength("a", "b") == pytest.approx(formula(3.0), abs=1e-3)
    assert [robot.name for robot in radio.present()] == ["A", "B"]
    world.remove(world.robots[0])
    assert radio.signal_strength("A", "B") is None
