"""Faults stay where they arise, as clients meet them: robots that do not fit, fall, collide or go bad."""

import logging
import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.handy import known
from tests.lands import land
from tests.server.test_adapter import P2AT_REPORT, TABLE_2, TICK, House, heard, look
from usarmjx.base.errors import SpecError
from usarmjx.engines.c.placement import SEARCH_RADIUS
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import options
from usarmjx.models.types.shapes import Shape
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim import single_world

WIRE = 0.011
"""Positions are told in whole centimetres [m]."""
SETTLED = 0.03
"""How far a robot that was put down moves until it stands [m]: springs, and a fall of 2 mm."""
UNSOLVED = 2e-3
"""How far others get within a second from where they would be [m]: the solver starts otherwise, and makes 10
iterations at most."""
ODD = replace(
    P2AT,
    name="Odd",
    cameras=(
        replace(P2AT.cameras[0], options=options(CameraDefFov=3.0, CameraMinFov=0.3, CameraMaxFov=2.0)),
    ),
)
"""A class with a camera whose usual field of view lies outside of its limits."""


def make_house(arena="yellow", seats=16):
    arena = ARENAS.get(arena) if isinstance(arena, str) else arena
    return House(DynamicWorld(arena, seed=1, max_robots=seats))


def init(name, *location, start=None):
    where = f"{{Start {start}}}" if start else "{{Location {},{},{}}}".format(*location)
    return f"INIT {{ClassName USARBot.{name}}} {where}"


def states(house, clients):
    return [jax.tree.map(np.array, house.world.state(client.robot)) for client in clients]


def assert_same_bits(before, after):
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert one.tobytes() == other.tobytes()


def moving(house):
    """Two robots that are on their way in the arena yellow."""
    clients = [house.connect(init("P2AT", start=f"Start{k}")) for k in (2, 5)]
    for client in clients:
        house.say(client, "DRIVE {Left 1.5} {Right 2.0}")
    house.run(2 * TICK)
    return clients


def reset_trees(house):
    """In how many control steps something was put back."""
    return int(house.world._single.world.faults.not_finite)


def spoil(house, client, what="qvel"):
    """Let a number of a robot's physics be none."""
    single = house.world._single
    group, member = single.scene.group_of(client.robot.slot)
    index = single.scene.groups[group].indices[member]
    if what == "qvel":
        single.engine.data.qvel[index.root_dofadr] = np.nan
    else:
        single.engine.data.qpos[index.root_qposadr + 2] = np.inf


def test_a_car_that_does_not_fit_is_refused_and_nobody_else_moves_by_a_bit(caplog):
    house, twin = make_house(), make_house()
    clients, others = moving(house), moving(twin)
    before = states(house, clients)
    car = house.connect(f"INIT {{ClassName USARBot.Sedan}} {TABLE_2}")
    assert car.robot is None
    assert "INIT refused: no room for a Sedan within 1 m of 4.50,1.90" in caplog.text
    assert_same_bits(states(house, clients), before)
    for each in (house, twin):
        each.run(TICK)
    assert_same_bits(states(house, clients), states(twin, others))
    assert [heard(client) for client in clients] == [heard(client) for client in others]
    assert not reset_trees(house)
    assert house.say(car, f"INIT {{ClassName USARBot.P2AT}} {TABLE_2}") == [], "it may ask again"
    assert car.robot is not None
    house.run()
    assert look(heard(car))[2][:2] == pytest.approx([4.5, 1.9], abs=WIRE)


@pytest.mark.parametrize(("name", "count", "near"), [("Hummer", 2, 1), ("P2DX", 12, 8)])
def test_who_is_told_a_place_that_is_taken_stands_beside_or_is_refused(caplog, name, count, near):
    """A Hummer is longer than a metre: the second is refused. Of 12 P2DX at least 8 have room within one."""
    caplog.set_level(logging.INFO)
    house = make_house("field")
    clients = [house.connect(init(name, 20, 3, 0)) for _ in range(count)]
    there = [client for client in clients if client.robot is not None]
    assert len(there) >= near
    assert len(house.world.robots) == len(there)
    assert caplog.text.count("INIT refused: no room") == count - len(there)
    stood = states(house, there)
    places = np.array([state.pos[:2] for state in stood])
    assert (np.linalg.norm(places - (20, -3), axis=-1) <= SEARCH_RADIUS + 1e-6).all()
    house.run()
    for client, place in zip(there, places, strict=True):
        told = look(heard(client))[2]
        assert told[:2] == pytest.approx((place[0], -place[1]), abs=WIRE), "as its first report says"
    house.run(3 * 50)
    assert not reset_trees(house)
    for before, after in zip(stood, states(house, there), strict=True):
        assert np.linalg.norm(after.pos - before.pos) < SETTLED
    for client in clients:
        if client.robot is None:
            house.say(client, init(name, -20, 8 * clients.index(client) - 48, 0))
            assert client.robot is not None, "it may ask again"


def test_a_robot_that_goes_bad_is_put_back_by_name_and_the_others_go_on(caplog):
    house, twin = make_house(), make_house()
    for each in (house, twin):
        moving(each)
        bad = each.connect(f"INIT {{ClassName USARBot.P2AT}} {{Name Unlucky}} {TABLE_2}")
        each.say(bad, "DRIVE {Left 1} {Right 1}")
        each.run(TICK)
        for client in each.clients:
            heard(client)
    *clients, bad = house.clients
    spoil(house, bad)
    for each in (house, twin):
        each.run(5 * TICK)
    assert reset_trees(house) == 1
    assert re.findall("the physics of (.*) went bad: put back", caplog.text) == ["Unlucky"]
    for mine, other in zip(states(house, clients), states(twin, twin.clients[:2]), strict=True):
        np.testing.assert_allclose(mine.pos, other.pos, atol=UNSOLVED)
    for client, other in zip(clients, twin.clients[:2], strict=True):
        told, wanted = heard(client), heard(other)
        assert [line.split(" {Name")[0].split("{Type")[-1] for line in told] == [
            line.split(" {Name")[0].split("{Type")[-1] for line in wanted
        ]
    lines = heard(bad)
    assert sum(line.startswith("STA") for line in lines) == 5
    assert all(any(re.fullmatch(form, line) for form in P2AT_REPORT) for line in lines), "no number is nan"
    assert look(lines)[2][:2] == pytest.approx([4.5, 1.9], abs=WIRE), "where it appeared, and it stands"
    house.say(bad, "DRIVE {Left 2} {Right 2}")
    house.run(50)
    assert look(heard(bad))[2][0] > 4.6, "it drives again"


@pytest.mark.parametrize("what", ["qvel", "qpos"])
def test_who_touches_a_bad_robot_is_put_back_with_it_and_nobody_else(caplog, what):
    """Whose height is infinite touches nobody any more."""
    house = make_house("field")
    first, second, third = (house.connect(init("P2AT", x, 0, 0)) for x in (0, 1.2, 6))
    house.say(first, "DRIVE {Left 4} {Right 4}")
    house.say(third, "DRIVE {Left 4} {Right 4}")
    house.run(3 * 50)  # the first pushes the second
    assert house.world.state(second.robot).pos[0] > 1.3
    spoil(house, first, what)
    house.run(1)
    (names,) = re.findall("the physics of (.*) went bad: put back", caplog.text)
    assert names == ("P2AT_0, P2AT_1" if what == "qvel" else "P2AT_0")
    there = [house.world.state(client.robot).pos[0] for client in (first, second, third)]
    assert there[0] == pytest.approx(0.0, abs=SETTLED)
    assert (there[1] == pytest.approx(1.2, abs=SETTLED)) == (what == "qvel")
    assert there[2] > 6.5


@pytest.mark.parametrize("name", ["P2AT", "Talon", "TeleMax", "ERS"])
def test_a_robot_that_falls_has_not_gone_bad(name):
    """From 8 m it is at 12.5 m/s, more than any of them drives."""
    house = make_house("field")
    client = house.connect(init(name, 3, 0, -8))
    assert client.robot is not None
    speeds = []
    for _ in range(5 * 50):
        house.run(1)
        speeds.append(np.linalg.norm(house.world.state(client.robot).linear))
    assert max(speeds) > 11.0
    assert not reset_trees(house)
    assert house.world.state(client.robot).pos[2] < 0.5
    assert speeds[-1] < 0.2, "it lies"


def test_who_falls_out_of_the_world_is_put_back(monkeypatch):
    monkeypatch.setattr(single_world, "MAX_FALL_HEIGHT", 30.0)
    plate = Shape(kind="box", size=(1.0, 1.0, 0.1), at=(0.0, 0.0, -0.1), surface="ground")
    house = make_house(land(plate))
    client = house.connect(init("P2AT", 0, 0, -0.3))
    house.say(client, "DRIVE {Left 3} {Right 3}")
    lowest = 0.0
    for _ in range(10 * 50):
        house.run(1)
        lowest = min(lowest, house.world.state(client.robot).pos[2])
    assert lowest == pytest.approx(-30.0, abs=2.0)  # of a control step's way at 24 m/s, and of the margin
    assert reset_trees(house) == 1
    assert house.world.state(client.robot).pos == pytest.approx([0.0, 0.0, 0.26], abs=SETTLED)


def refused_by_its_camera(monkeypatch):
    return "Odd", "fields of view are 0.3 to 2, at first 3 rad"


def refused_by_its_sensors(monkeypatch):
    def fails(*args):
        raise SpecError("Sonar: a value of shape (2,) was read")

    monkeypatch.setattr(single_world, "start_sensors", fails)
    return "P2AT", "a value of shape"


@pytest.mark.parametrize("refused", [refused_by_its_camera, refused_by_its_sensors])
def test_an_init_that_is_refused_late_leaves_nothing(monkeypatch, caplog, refused):
    house = make_house(seats=3)
    clients = moving(house)
    before = states(house, clients)
    with known(ODD), monkeypatch.context() as patch:
        name, why = refused(patch)
        late = house.connect(f"INIT {{ClassName {name}}} {TABLE_2}")
        assert late.robot is None
        assert re.search(f"INIT refused: .*{re.escape(why)}", caplog.text)
    assert len(house.world.robots) == 2
    assert_same_bits(states(house, clients), before)
    house.say(late, f"INIT {{ClassName P2AT}} {TABLE_2}")
    assert late.robot is not None
    house.run(TICK)
    assert look(heard(late))[2][:2] == pytest.approx([4.5, 1.9], abs=WIRE)
    assert house.connect(init("P2AT", start="Start3")).robot is None, "no seat is left"
    house.leave(late)
    assert house.connect(init("P2AT", start="Start3")).robot is not None
