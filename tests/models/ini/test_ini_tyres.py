"""Tyres, brakes and steering from ini files (manual 14.4.2.3, 14.4.2.4), on C MuJoCo.

Oracles: Coulomb's friction on a slope, a ball's bounce by its coefficient of restitution, Karma's own formula
for slip, torque over inertia, rotations about axes that lean.
"""

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.backend import numpy_backend
from usarmjx.base.registry import Registry
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sim.configure import settings_by_kind
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

SETTINGS = settings_by_kind()
STEP = Physics().timestep


@pytest.fixture
def load(tmp_path):
    def robot_of(text, name="P2AT", *says):
        path = tmp_path / "a.ini"
        path.write_text(text)
        stock: Registry = Registry("robot")
        for one in ("P2AT", "P2DX", "Cooper"):
            stock.add(one, ROBOTS.get(one))
        loaded = load_robots([path], stock, settings=SETTINGS)
        assert len(loaded.warnings) == len(says), loaded.warnings
        assert all(part in text for part, text in zip(says, loaded.warnings, strict=True))
        loaded.apply(stock)
        return stock.get(name)

    return robot_of


def stand(robot, seconds, tilt=0.0, height=0.262):
    """Motion of a braked robot on a floor that leans uphill along x: x, z and their speeds (steps, 4)."""
    spec = new_spec(ArenaSpec(name="floor", starts=(), extent=((-3, 3), (-3, 3))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, height))
    model = spec.compile()
    model.opt.gravity[:] = 9.81 * np.array([-math.sin(tilt), 0.0, -math.cos(tilt)])
    data = mujoco.MjData(model)
    data.ctrl[[i for i in range(model.nu) if model.actuator(i).name.endswith("/hold")]] = 1.0
    rows = []
    for _ in range(round(seconds / STEP)):
        mujoco.mj_step(model, data)
        rows.append((*data.qpos[[0, 2]], *data.qvel[[0, 2]]))
    return np.array(rows)


def tyres(load, **keys):
    return load("[USARBot.P2AT]\n" + "\n".join(f"Tire{key}={value}" for key, value in keys.items()))


SLOPE = math.radians(50)
COULOMB_RTOL = 0.1  # it is measured while the weight moves to the lower wheels


@pytest.mark.parametrize(("roll", "lateral"), [(7.5, 7.5), (3.75, 15.0), (5.0, 5.0), (11.0, 11.0)])
def test_friction_is_in_proportion_to_the_mean_of_both_directions(load, roll, lateral):
    """a = g (sin - mu cos) of a block that slides; 15 stands for 0.8."""
    friction = 0.8 * math.sqrt(roll * lateral) / 15
    path = stand(tyres(load, RollFriction=roll, LateralFriction=lateral), 1.0, SLOPE)
    pace = np.polyfit(np.arange(100) * STEP, path[-100:, 2], 1)[0]
    assert -pace == pytest.approx(9.81 * (math.sin(SLOPE) - friction * math.cos(SLOPE)), rel=COULOMB_RTOL)


@pytest.mark.parametrize("key", ["RollFriction", "LateralFriction"])
def test_the_more_friction_the_less_it_slides(load, key):
    ways = [-stand(tyres(load, **{key: value}), 0.6, SLOPE)[-1, 0] for value in (2, 6, 15, 40)]
    assert all(more > 1.05 * less for more, less in pairwise(ways)), ways


# Values in rising order: all of them slip less than 0.06, which is a stock tyre's at 0.7 m/s.
SLIPS = {
    "RollSlip": (0.005, 0.02, 0.05),
    "LateralSlip": (0.005, 0.02, 0.05),
    "SlipRate": (0.0, 0.0001, 0.0003),
}


@pytest.mark.parametrize("key", SLIPS)
def test_the_more_slip_the_faster_it_creeps_down_a_slope(load, key):
    creeps = []
    for value in (*SLIPS[key], None):
        path = stand(tyres(load, **({} if value is None else {key: value})), 2.0, math.radians(10))
        creeps.append(float(path[100, 0] - path[-1, 0]))
    assert all(less < 0.95 * more for less, more in pairwise(creeps)), creeps


def test_the_least_slip_counts_where_there_is_no_rate(load):
    """Karma's slip is MinSlip plus SlipRate times speed: the creep is in proportion to it."""
    creeps = []
    for least in (0.01, 0.02, 0.04):
        path = stand(tyres(load, MinSlip=least, SlipRate=0), 2.0, math.radians(10))
        creeps.append(float(path[200, 0] - path[-1, 0]))
    assert creeps[1] / creeps[0] == pytest.approx(2.0, rel=0.05)
    assert creeps[2] / creeps[1] == pytest.approx(2.0, rel=0.05)


def test_the_softer_the_tyre_the_lower_it_stands(load):
    heights = [stand(tyres(load, Softness=value), 1.0)[-1, 1] for value in (0, 0.5, 1, 3)]
    sinks = [0.26 - height for height in heights]
    assert sinks[0] < 2e-4
    # A spring that settles in twice the time is a quarter as stiff; less the part that friction bears.
    assert sinks[2] == pytest.approx(4 * sinks[0], rel=0.3)
    assert all(less < more for less, more in pairwise(sinks))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9])
def test_a_tyre_throws_back_its_restitution_of_the_speed(load, share):
    speeds = stand(tyres(load, Restitution=share), 1.0, height=0.46)[:, 3]
    assert speeds.max() / -speeds.min() == pytest.approx(share, abs=0.06)
    assert speeds.max() > 1.5 * stand(tyres(load), 1.0, height=0.46)[:, 3].max()


def test_stock_figures_leave_a_robot_as_it_is(load):
    stock = tyres(load, RollFriction=15, LateralSlip=0.06, MinSlip=0.001, SlipRate=0.0005, Softness=0)
    assert stock == ROBOTS.get("P2AT")


def test_adhesion_is_ignored_and_says_why(load):
    robot = load("[USARBot.P2AT]\nTireAdhesion=1\n", "P2AT", "TireAdhesion is ignored: contacts push and rub")
    assert robot == ROBOTS.get("P2AT")


# Brakes and steering


def drive(world, steps, **keys):
    group, _ = world.scene.group_of(0)
    with numpy_backend():
        told = CommandUpdate(drive=keys)
        plan = world.scene.groups[group].plan
        world.edit(0, command=update_command(plan, world.state_of(0).command, told))
    for _ in range(steps):
        world.step()


def on_the_floor(robot, height):
    world = SingleWorld(build_scene(FLAT, ()), seed=0, seats=1)
    world.add(robot, robot.name, [((0.0, 0.0, height), np.array([1.0, 0.0, 0.0, 0.0]))])
    for _ in range(25):
        world.step()
    return world


def joint(world, name):
    group, member = world.scene.group_of(0)
    index = world.scene.groups[group].indices[member]
    return float(world.engine.data.qpos[index.qposadr[joint_names(world.roster[0].spec).index(name)]])


PLACES = {"FL": (0.16, -0.2), "FR": (0.16, 0.2), "RL": (-0.16, -0.2), "RR": (-0.16, 0.2)}


def cart_text(front, rear=None):
    """A cart of 12 kg with four wheels; fields of the front and the rear ones."""
    wheel = "JointClass=class'KCarWheelJoint',bSuspensionLocked=True,Radius=0.1,Width=0.05"
    lines = ["[USARBot.Cart]", "Dimensions=(X=0.5,Y=0.3,Z=0.12)", "Weight=12"]
    for name, (x, y) in PLACES.items():
        own = front if x > 0 or rear is None else rear
        lines.append(f"JointParts=(PartName={name},ParentPos=(X={x},Y={y},Z=0.05),{wheel}{own and ','}{own})")
    return "\n".join(lines)


def rolled(load, brake):
    """How far a cart of 12 kg rolls that is told to stop at 0.6 m/s [m]."""
    cart = load(cart_text(f"bSteeringLocked=True{brake}"), "Cart")
    world = on_the_floor(cart, 0.151)
    drive(world, 60, Left=6.0, Right=6.0)
    start = world.engine.data.qpos[0]
    drive(world, 100, Left=0.0, Right=0.0)
    return float(world.engine.data.qpos[0] - start)


def test_the_weaker_the_brake_the_farther_it_rolls(load):
    ways = [rolled(load, f",BrakeTorque={torque}") for torque in (0, 0.2, 0.5, 2.0)]
    assert all(more > 1.2 * less for more, less in pairwise(ways)), ways
    assert ways[0] == pytest.approx(0.6 * 2.0, rel=0.1), "without a brake it rolls on"
    # v2 / 2 a, with a = 4 T r / (m r2 + 4 J): wheels' motors have the inertia of the load they move.
    inertia = 12 * 0.01 + 4 * (0.03 + 0.42 * 0.01)
    assert ways[2] == pytest.approx(0.36 / 2 / (4 * 0.5 * 0.1 / inertia), rel=0.2)
    assert rolled(load, "") <= ways[3] + 1e-3, "what is left out brakes with all of the motor's torque"


def test_a_wheel_that_is_not_driven_brakes_in_a_car_and_rolls_elsewhere(load):
    idle = "\nWheels=(Number=2,PowerType=Not_Powered)\nWheels=(Number=3,PowerType=Not_Powered)"
    car = load(cart_text("", "bSteeringLocked=True,BrakeTorque=0.4") + idle, "Cart")
    assert [(wheel.joint, wheel.powered, wheel.brakes) for wheel in car.drive.wheels[2:]] == [
        ("RL", False, True),
        ("RR", False, True),
    ]
    assert [part.motor.torque for part in car.wheels if part.name.startswith("R")] == [0.4, 0.4]
    world = on_the_floor(car, 0.151)
    drive(world, 60, Speed=6.0)
    at_speed = joint(world, "RL")
    drive(world, 25, Speed=6.0)
    assert joint(world, "RL") - at_speed == pytest.approx(6.0 * 0.5, rel=0.1), "it rolls along"
    says = ["BrakeTorque is ignored: RL is not driven", "BrakeTorque is ignored: RR is not driven"]
    skid = load(
        cart_text("bSteeringLocked=True", "bSteeringLocked=True,BrakeTorque=0.4") + idle, "Cart", *says
    )
    assert [part.name for part in skid.wheels if part.motor is None] == ["RL", "RR"]


@pytest.mark.parametrize("size", [1.0, 2.0])
def test_a_car_of_pairs_steers_to_what_it_is_told_as_firmly_as_ours(load, size):
    """At 0.3 m/s and a turning radius of b / tan 0.3, each wheel's axis meets the centre."""
    text = cart_text("", "bSteeringLocked=True").replace("Weight=12", f"Weight={12 * size**2}")
    world = on_the_floor(load(text, "Cart"), 0.151)
    for told in (0.3, -0.3):
        drive(world, 100, Speed=3.0, FrontSteer=told)
        radius = 0.32 / math.tan(told)
        wanted = [math.atan(0.32 / (radius - 0.2)), math.atan(0.32 / (radius + 0.2))]
        assert [joint(world, "FL_Steer"), joint(world, "FR_Steer")] == pytest.approx(wanted, abs=2e-3)


def test_the_stronger_the_steering_the_farther_a_standing_wheel_turns(load):
    """SteerTorque 1000 is the class's own, which turns a standing car's wheels all the way."""
    angles = []
    for torque in (15, 60, 1000):
        world = on_the_floor(load(f"[USARBot.Cooper]\nSteerTorque={torque}", "Cooper"), 0.72)
        drive(world, 50, FrontSteer=0.4)
        angles.append((joint(world, "LeftFWheel_Steer") + joint(world, "RightFWheel_Steer")) / 2)
    assert angles[0] < 0.7 * angles[1] < 0.7 * angles[2], angles
    assert angles[2] == pytest.approx(0.4, abs=0.02)


RAKE, CAMBER = math.radians(30), math.radians(20)


def test_a_fork_that_leans_back_turns_its_wheel_about_the_fork(load):
    """ParentAxis is the axis of steering and suspension (14.4.2.4): a rake of 30 degrees."""
    fork = f"ParentAxis=(X={-math.sin(RAKE):.6f},Z={math.cos(RAKE):.6f})"
    text = cart_text(fork, "bSteeringLocked=True").replace(
        "bSuspensionLocked=True", "bSuspensionLocked=False"
    )
    car = load(text, "Cart")
    axis = (-math.sin(RAKE), 0.0, -math.cos(RAKE))
    parts = {part.name: part for part in car.parts}
    assert parts["FL_Steer"].axis == pytest.approx(axis, abs=1e-5)
    assert parts["FL_Suspension"].axis == pytest.approx(axis, abs=1e-5)
    assert parts["FL_Suspension"].spring.load == pytest.approx(3 * 9.81 * math.cos(RAKE), rel=1e-3)
    assert parts["RL_Suspension"].axis == (0.0, 0.0, -1.0)
    world = on_the_floor(car, 0.16)
    drive(world, 50, Speed=0.0, FrontSteer=0.4)
    model, data = world.engine.model, world.engine.data
    (wheel,) = (i for i in range(model.nbody) if model.body(i).name.endswith("/FL"))
    knuckle = model.body_parentid[wheel]
    fixed = data.xmat[model.body_parentid[knuckle]].reshape(3, 3)
    angle, left = joint(world, "FL_Steer"), np.array([0.0, 1.0, 0.0])
    assert angle > 0.3
    # Rodrigues: the axle, across the fork, turned about it by that angle.
    fork = np.array([-math.sin(RAKE), 0.0, math.cos(RAKE)])
    wanted = left * math.cos(angle) + np.cross(fork, left) * math.sin(angle)
    np.testing.assert_allclose(fixed.T @ data.xmat[knuckle].reshape(3, 3)[:, 1], wanted, atol=1e-5)


def test_wheels_whose_axles_lean_stand_on_their_edges_and_roll(load):
    """Camber: a tyre of radius r and width w reaches r cos + w / 2 sin below its axle."""
    lines = cart_text("bSteeringLocked=True,ParentAxis2={}").splitlines()
    for i, (_, y) in enumerate(PLACES.values()):
        axle = f"(Y={math.cos(CAMBER):.6f},Z={math.copysign(math.sin(CAMBER), y):.6f})"
        lines[3 + i] = lines[3 + i].replace("{}", axle)
    world = on_the_floor(load("\n".join(lines), "Cart"), 0.17)
    height = 0.05 + 0.1 * math.cos(CAMBER) + 0.025 * math.sin(CAMBER)
    assert world.engine.data.qpos[2] == pytest.approx(height, abs=1e-3)
    start = world.engine.data.qpos[0]
    drive(world, 100, Left=3.0, Right=3.0)
    # The edges on which it rolls are circles of the tyre's radius.
    assert world.engine.data.qpos[0] - start == pytest.approx(3.0 * 0.1 * 2.0, rel=0.1)
