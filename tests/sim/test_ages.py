"""Worlds of any age: what a robot reads, and when, does not depend on how long its world has run."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from benchmarks.days import silent
from tests.arenas import FLAT
from usarmjx.base.clock import Clock, cycle_share, intervals_in_steps, next_due
from usarmjx.engines.planar.responses import find_response, override_response
from usarmjx.models.robots.pioneer import P2DX
from usarmjx.models.types.arena import Tag, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import SENSORS
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

HOURS = (1, 100, 10_000)
PERIOD = 0.02
STEPS = 25
WALL = Shape(kind="box", size=(0.1, 4.0, 1.0), at=(3.0, 0.0, 1.0), surface="wall")
WARD = replace(
    FLAT,
    shapes=(WALL,),
    victims=(Victim(name="Ada", at=(0.5, 1.2, 0.12), posture="sitting"),),
    tags=(Tag(at=(1.0, 0.0, 0.0)),),
)


def robot(kinds):
    return replace(P2DX, cameras=(), sensors=tuple(map(silent, kinds)))


def aged(world, hours):
    """The world, set on by some hours, with its robots' batteries full then."""
    step = np.int32(round(hours * 3600 / PERIOD))
    groups = tuple(group.replace(battery_start=group.battery_start + step) for group in world.groups)
    return world.replace(step=world.step + step, groups=groups)


def served(hours):
    """Readings of every sensor of a driving robot in a served world."""
    world = SingleWorld(build_scene(WARD, ()), seed=0, seats=1)
    world.world = aged(world.world, hours)
    slot = world.add(robot([kind for kind, _ in SENSORS]), "R", [((0.0, 0.0, 0.3), np.array([1.0, 0, 0, 0]))])
    speed = world.state_of(slot).command.setpoint + np.array([2.0, 4.0], np.float32)
    world.edit(slot, command=world.state_of(slot).command.replace(setpoint=speed))
    readings = []
    for _ in range(STEPS):
        world.step()
        readings.append(world.observe([slot])[slot])
    return readings


def test_served_sensors_read_the_same_bits_at_any_age():
    young = served(0)
    for hours in HOURS:
        for step, (now, then) in enumerate(zip(served(hours), young, strict=True)):
            for (kind, _), one, other in zip(SENSORS, now, then, strict=False):
                where = f"{kind} in step {step} after {hours} h"
                np.testing.assert_array_equal(one.fresh, other.fresh, err_msg=where)
                np.testing.assert_array_equal(one.value, other.value, err_msg=where)


SOME = ("IMU", "INS", "Odometry", "Encoder", "GroundTruth", "Sonar", "Battery")


@pytest.mark.every_run("c")
@pytest.mark.parametrize(
    ("engine", "kinds"),
    [
        *((engine, SOME) for engine in ("c", "planar", "jax", "warp")),
        *(
            pytest.param(engine, SENSORS.names(), marks=pytest.mark.thorough)
            for engine in ("c", "planar", "warp", "jax")
        ),
    ],
    ids=["c", "planar", "jax", "warp", "c-every", "planar-every", "warp-every", "jax-every"],
)
def test_batched_sensors_read_the_same_bits_at_any_age(engine, kinds):
    if engine == "warp":
        pytest.importorskip("warp", reason="needs warp-lang")
    mine = robot(kinds)
    override_response(mine, find_response(P2DX))  # what it weighs more is no matter here
    batch = Batch(build_scene(WARD, [mine]), worlds=1, engine=engine)

    def run(hours):
        state = batch.reset(0)
        state, _ = batch.observe(state.replace(worlds=aged(state.worlds, hours)))
        state = batch.drive(state, 0, {"Left": 2.0, "Right": -2.0})
        readings = []
        for _ in range(STEPS):
            state, now = batch.observe(batch.step(state))
            readings.append(jax.device_get(now))
        return readings

    young = run(0)
    assert sum(bool(one[0][kinds.index("IMU")].fresh[0, 0]) for one in young) > 1, "it measures again"
    for hours in HOURS:
        for now, then in zip(run(hours), young, strict=True):
            for kind, one, other in zip(kinds, now[0], then[0], strict=True):
                if kind == "MissionTime":  # the age itself, in minutes
                    other = other.replace(value=other.value + np.float32(60 * hours))
                jax.tree.map(
                    partial(np.testing.assert_array_equal, err_msg=f"{kind} after {hours} h"), one, other
                )


@pytest.mark.parametrize("interval", [0.0, 0.02, 0.05, 0.033, 0.2, 1e9])
def test_the_mean_rate_of_a_schedule_is_exact_at_any_age(interval):
    """The k-th time is the first step not before k intervals, counted in whole numbers."""
    whole, parts = intervals_in_steps((interval,), PERIOD)
    for age in (0, 2**31 - 40):
        due, lead, times = np.array([age], np.int32), np.zeros(1, np.int32), []
        for step in range(200):
            now = np.array(age + step, np.int64).astype(np.int32)
            if now - due[0] >= 0:
                times.append(step)
                due, lead = (np.asarray(x) for x in next_due(now, due, lead, (whole, parts)))
        ratio = round(interval / PERIOD, 9)
        every = max(ratio, 1.0)
        expected = [int(np.ceil(k * every - 1e-6)) for k in range(200)]
        assert times == [step for step in expected if step < 200]


def test_a_cycle_goes_on_evenly_for_a_year():
    """Against whole numbers: a frequency whose increment a float32 holds exactly."""
    year = round(365 * 24 * 3600 / PERIOD)
    frequency = np.float32(2.0**-7 / PERIOD)
    steps = year + np.arange(300)
    share = cycle_share(Clock(step=steps.astype(np.int32), period=PERIOD), frequency, 0, np)
    np.testing.assert_allclose(share, steps % 128 / 128, atol=1e-6)


def test_time_is_monotone_for_a_year_and_beyond():
    world = SingleWorld(build_scene(FLAT, ()), seed=0, seats=1)
    world.world = world.world.replace(step=np.array(2**31 - 3, np.int32))
    times = []
    for _ in range(6):
        world.step()
        times.append(world.time)
    np.testing.assert_allclose(np.diff(times), PERIOD, atol=1e-6)
    assert times[-1] > 365 * 24 * 3600
