"""For a served world JAX traces and compiles nothing: over all classes, commands, sensors and effecters."""

from contextlib import contextmanager
from dataclasses import replace
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.handy import TAGGER, known
from tests.listening import compilations
from tests.sensors.test_numpy_backend import EVERYTHING
from tests.server.test_adapter import TICK, House, heard
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.effecters import effecters_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.suite import suite_of
from usarmjx.server.protocol import commands as wire
from usarmjx.server.protocol.command_parsers import parse_command
from usarmjx.server.protocol.grammar import parse_message
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest

WHOLE = replace(
    EVERYTHING,
    name="Whole",
    packages=TAGGER.packages,
    effecters=(*TAGGER.effecters, Mount(kind="RollerTable", name="Table", at=(0.0, 0.0, -0.2))),
)
"""A robot with a sensor and an effecter of every type."""
ORDERS = (0, 1, 2, 3, 10, 11, 12)
OPCODES = ("angle", "velocity", "torque", "relangle", "relvelocity", "reltorque")
SENSOR_ORDERS = (
    "{Opcode SCAN}",
    "{Opcode RESET}",
    "{Opcode POSE} {Params 1,2,3,0,0,1}",
    "{Opcode Read} {Params 1001}",
    "{Opcode Write} {Params 1001 hello}",
)
INIT = "INIT {{ClassName USARBot.{0}}} {{Name {0}}}"
AT_ANY_TIME = (
    "GETSTARTPOSES",
    "TRACE {On True} {Interval 0.1} {Color Red}",
    "TRACE {On False}",
    "GETGEO {Type Robot}",
    "GETCONF {Type Robot}",
    "SET {Type Camera} {Client 127.0.0.1} {Robot P2AT} {Name Camera}",
    "SET {Type Camera} {Client 127.0.0.1}",
    "SET {Type Viewports} {Config QuadView} {Viewport1 Camera} {Viewport2 Disable}",
    "SET {Type Joint} {Name Nobody} {Opcode Angle} {Params 1}",
    "MULTIDRIVE {Nobody 1}",
    "DRIVE {Light True}",
    "DRIVE {Flip True}",
    "DRIVE {Left 1e30} {Right -3}",
    "DRIVE {Name Nobody} {Order 1} {Value 2}",
    "DRIVE {WheelNumber 0} {WheelSpeed 1} {WheelSteer 0.2} {WheelNumber 1} {WheelSpeed 30} {Normalized True}",
    "MISPKG {Name Nobody} {Link 1} {Value 1}",
    "nonsense {",
)


def lines_for(robot):
    """All that a robot of a class can be told."""
    yield from AT_ANY_TIME
    keys = wire.DRIVE_KEYS
    yield from (f"DRIVE {{{key} 0.5}}" for key in keys)
    yield "DRIVE " + " ".join(f"{{{key} 20}}" for key in keys) + " {Normalized True}"
    for number, name in enumerate(joint_names(robot)):
        order = ORDERS[number % len(ORDERS)]
        yield f"DRIVE {{Name {name}}} {{Order {order}}} {{Value 0.1}} {{Steer 0.1}}"
        yield f"SET {{Type Joint}} {{Name {name}}} {{Opcode {OPCODES[number % 6]}}} {{Params 0.1}}"
        yield f"SET {{Type Joint}} {{Name {name}}} {{Opcode Stiffness}} {{Params 0.5}}"
        yield f"MULTIDRIVE {{{name} 0.2}}"
    for package in robot.packages:
        links = [link.number for link in package.links]
        for order in ORDERS:
            told = " ".join(f"{{Link {n}}} {{Value 0.1}} {{Order {order}}}" for n in links)
            yield f"MISPKG {{Name {package.name}}} {told}"
    for sensor in suite_of(robot).sensors:
        item = f"{{Type {sensor.kind}}} {{Name {sensor.mounts[0].name}}}"
        yield from (f"SET {item} {order}" for order in SENSOR_ORDERS)
        yield from (f"GETGEO {item}", f"GETCONF {item}")
    for effecter in effecters_of(robot):
        item = f"{{Type {effecter.kind}}} {{Name {effecter.mount.name}}}"
        for opcode in effecter.opcodes:
            yield f"SET {item} {{Opcode {opcode.name}}} {{Params 0.3}}"
            yield f"SET {item} {{Opcode {opcode.name}}}"
        yield from (f"GETGEO {item}", f"GETCONF {item}")
    for camera in robot.cameras:
        yield f"SET {{Type Camera}} {{Name {camera.name}}} {{FOV 0.7}}"
        yield f"SET {{Type Camera}} {{Name {camera.name}}} {{Opcode Zoom}} {{Params 0.5}}"
    yield from ("CAMERA {Rotation 0,0.1,0.2} {Zoom 0.6}", "CAMERA {Rotation 0,0.1,-0.2} {Order 1}")
    for kind in ("MisPkg", "Camera", "Effecter", "Sensor"):
        yield from (f"GETGEO {{Type {kind}}}", f"GETCONF {{Type {kind}}}")


@contextmanager
def nothing_compiled():
    """Inside, JAX must trace and compile nothing, nor make an array: it may have compiled for that before."""
    with compilations() as events, jax.transfer_guard("disallow_explicit"):
        yield
    assert events == []


def serve(arena, robots, inits=()):
    """Let robots of classes join, be told all that they can be, report for a second, and leave.

    Returns what each reported, and what it was answered by RES.
    """
    answers = [[] for _ in robots]
    with nothing_compiled():
        world = DynamicWorld(ARENAS.get(arena), seed=1, max_robots=len(robots))
        world.warm_up()
        house, radio = House(world), RadioChannel(world, RadioSettings(shadowing=3.0, period=0.1))
        for place, robot in enumerate(robots):
            client = house.connect(inits[place] if inits else INIT.format(robot.name))
            assert client.robot is not None, robot.name
            for line in lines_for(robot):
                answers[place] += [answer for answer in house.say(client, line) if answer.startswith("RES")]
            house.say(client, "TRACE {On True}")
        for _ in range(5):
            house.run(TICK)
            for client in house.clients:
                client.add_trace_point()
            names = [presence.name for presence in radio.present()]
            for name in names[1:]:
                radio.signal_strength(names[0], name)
                radio.obstacles(name, names[0])
        look_on(world)
        put_back(house)
        lines = [heard(client) for client in house.clients]
        for client in list(house.clients):
            house.leave(client)
    assert not world.robots
    return lines, answers


def look_on(world):
    """Ask for what pictures and the page of the world are made of."""
    world.door_angles()
    world.sketches()
    world.solids_between((0.0, 0.0, 0.1), (3.0, 2.0, 0.5))
    for robot in world.robots.values():
        world.battery(robot)
        for camera in range(len(robot.cameras)):
            world.viewpoint(CameraRequest(robot, camera, 40, 30))


def put_back(house):
    """Let the physics of a robot go bad."""
    single = house.world._single
    before = int(single.world.faults.not_finite)
    single.engine.data.qvel[single.scene.groups[0].root_dofadr[0]] = np.nan
    house.run(TICK)
    assert int(single.world.faults.not_finite) == before + 1


@pytest.fixture(scope="module", autouse=True)
def whole():
    with known(WHOLE):
        yield


def test_every_class_may_come_be_told_everything_report_and_leave():
    robots = [robot for name, robot in ROBOTS if name != "Submarine"]
    inits = [
        INIT.format(robot.name) + f" {{Location {12 * (n % 6) - 30},{12 * (n // 6) - 30},0}}"
        for n, robot in enumerate(robots)
    ]
    lines, _ = serve("field", robots, inits)
    for robot, told in zip(robots, lines, strict=True):
        kinds = {line.split()[0] for line in told}
        assert kinds >= {"STA", "SEN"}, robot.name


@pytest.mark.parametrize("arena", ["yellow", "factory"])
def test_nor_for_any_sensor_or_effecter_among_victims_tags_and_doors(arena):
    (lines,), (answers,) = serve(arena, [WHOLE])
    told = {line.split("{Type ")[1].split("}")[0] for line in lines if line.startswith("SEN")}
    assert told >= {sensor.kind for sensor in suite_of(WHOLE).sensors} - {"Touch"}
    done = {line.split("{Type ")[1].split("}")[0] for line in answers if "{Status Failed}" not in line}
    assert done >= {effecter.kind for effecter in effecters_of(WHOLE)} | {"Odometry", "INS", "Encoder"}


def test_nor_in_water():
    serve("pool", [ROBOTS.get("Submarine")])


def test_the_lines_are_commands_of_every_type():
    parsed = {type(parse_command(parse_message(line))) for line in lines_for(WHOLE)}
    init = type(parse_command(parse_message(INIT.format("Whole"))))
    # By a program, by the session, and by a client without a robot.
    made_elsewhere = {wire.OwnCommand, wire.InvalidSet, wire.Control}
    assert parsed | {init} >= set(get_args(wire.Command)) - made_elsewhere


def test_what_is_counted():
    """What JAX traces, and what it may have compiled before."""
    jnp.arange(3)
    with pytest.raises(AssertionError, match="jaxpr_trace"), nothing_compiled():
        jax.eval_shape(lambda x: x + 1, np.ones(3))
    with pytest.raises(jax.errors.JaxRuntimeError, match="transfer"), nothing_compiled():
        jnp.asarray(np.ones(3))
