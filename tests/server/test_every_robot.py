"""Every robot class over TCP: INIT, STA, GEO, CONF, and its own form of DRIVE moves it as it should.

Ground truth is compared before and after the order, in the wire's frame (x forward, y right, z down, yaw
clockwise), turned to the heading before. Expected motion is a range of what the figures of the manual's
section 12 give; the physics in detail is in tests/models.
"""

import math
import re
from dataclasses import dataclass, replace

import pytest

from tests.server.peers import Peer, serving
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.dynamic_world import DynamicWorld

ROUNDING = 0.01
"""Times of reports have two decimals [s]: without this, some trips would be a report of 0.2 s longer."""
F4 = r"-?\d+\.\d{4}"
HEADLIGHT = r"{LightToggle False} {LightIntensity 0} {Battery \d+} {View -1}"
STEER = rf"{{FrontSteer {F4}}} {{RearSteer {F4}}} "
STA = {
    "GroundVehicle": STEER,
    "AerialVehicle": "",
    "LeggedRobot": "",
    "NauticVehicle": rf"{{SternPlaneAngle {F4}}} {{RudderAngle {F4}}} ",
}
VECTOR = r"(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)"


@dataclass(frozen=True)
class Trip:
    """What to tell a robot, and where it must be then: ranges of forward, right, down [m], yaw [rad]."""

    name: str
    orders: tuple[str, ...]
    seconds: float
    forward: tuple[float, float] = (-0.3, 0.3)
    right: tuple[float, float] = (-0.5, 0.5)
    down: tuple[float, float] = (-0.3, 0.3)
    yaw: tuple[float, float] = (-0.4, 0.4)
    kind: str = "GroundVehicle"
    steering: str = "SkidSteered"
    arena: str = "field"
    start: str = ""
    percents: bool = False


def skid(name, spin, low, high, seconds=3.0, **more):
    """Straight ahead by wheel speed; the range is about radius x spin x time, less the start."""
    return Trip(name, (f"DRIVE {{Left {spin}}} {{Right {spin}}}",), seconds, forward=(low, high), **more)


def car(name, low, high):
    """Ahead and to the left, against the wire's yaw (manual 9.4: FrontSteer is positive to the left)."""
    return Trip(
        name,
        ("DRIVE {Speed 8} {FrontSteer 0.2}",),
        4.0,
        forward=(low, high),
        right=(-6.0, -0.3),
        yaw=(-1.6, -0.1),
        steering="AckermanSteered",
    )


TRIPS = (
    skid("P2AT", 3, 0.8, 1.2),
    skid("StereoP2AT", 3, 0.8, 1.2),
    skid("P2DX", 6, 1.0, 1.5),
    skid("ATRVJr", 3, 1.2, 1.75),
    skid("Zerg", 6, 0.8, 1.1),
    skid("Kurt2D", 6, 0.5, 4.0),
    skid("Kurt3D", 6, 0.5, 4.0),
    skid("OmniP2AT", 3, 0.8, 1.2),
    skid("OmniP2DX", 6, 1.0, 1.5),
    skid("Tarantula", 3, 0.3, 1.0),
    skid("Talon", 4, 1.2, 1.7),
    skid("Rugbot", 4, 1.1, 1.5),
    skid("kenaf", 3, 0.3, 2.0),
    skid("TeleMax", 3, 1.2, 1.75),
    skid("Soryu", 3, 0.2, 1.2),
    car("Hummer", 5.0, 12.5),
    car("SnowStorm", 5.0, 12.5),
    car("Sedan", 4.0, 9.5),
    car("Cooper", 4.0, 9.5),
    Trip(
        "Lisa",
        (
            "DRIVE {WheelNumber 0} {WheelSpeed 3.14} {WheelSteer 0.0} "
            "{WheelNumber 1} {WheelSpeed 3.14} {WheelSteer 0.0}",
        ),
        3.0,
        forward=(0.3, 2.0),
        steering="OmniDrive",
    ),
    Trip(
        "AirRobot",
        ("DRIVE {AltitudeVelocity 1} {LinearVelocity 1} {RotationalVelocity 0.3}",),
        3.0,
        forward=(0.5, 3.0),
        right=(-0.2, 2.5),
        down=(-3.2, -2.0),
        yaw=(0.6, 1.0),
        kind="AerialVehicle",
        steering="RotaryWing",
    ),
    Trip(
        "Passarola",
        ("DRIVE {XZAngle 0.5} {ThrustPropeller 1} {TailPropeller -0.2}",),
        8.0,
        forward=(1.0, 7.5),
        right=(0.1, 6.0),
        down=(-4.5, -0.5),
        yaw=(0.5, 1.7),
        kind="AerialVehicle",
        steering="RotaryWing",
    ),
    Trip(
        "Submarine",
        ("DRIVE {Propeller 6.28} {Rudder 0.4363}",),
        20.0,
        forward=(0.5, 6.2),
        right=(-0.2, 4.0),
        yaw=(0.01, 2.0),
        kind="NauticVehicle",
        steering="VariableDepth",
        arena="pool",
        start="Water1",
    ),
    Trip("QRIO", ("MULTIDRIVE {HeadPan 0.3}",), 2.0, kind="LeggedRobot", steering="TwoLegs"),
    Trip("ERS", ("MULTIDRIVE {HeadPan 0.3}",), 2.0, kind="LeggedRobot", steering="FourLegs"),
    Trip(
        "ComStation",
        ("DRIVE {Light True}",),
        1.0,
        forward=(-0.01, 0.01),
        right=(-0.01, 0.01),
        steering="None",
    ),
)


def in_percents(trip):
    """The same trip, told in percents of what each key of DRIVE is at most (manual 9.4, Normalized)."""
    full = ROBOTS.get(trip.name).drive.full_scale
    (order,) = trip.orders
    told = re.findall(r"{(\w+) (-?[\d.]+)}", order)
    keys = "".join(f" {{{key} {100 * float(value) / full[key]:.3f}}}" for key, value in told)
    return replace(trip, orders=(f"DRIVE{keys} {{Normalized True}}",), percents=True)


OTHER_DRIVES = ("Hummer", "Submarine", "AirRobot", "Passarola")
TRIPS += tuple(in_percents(trip) for trip in TRIPS if trip.name in OTHER_DRIVES)


@pytest.fixture(scope="module")
def ports():
    """Servers of all arenas that the trips need."""
    worlds = [DynamicWorld(ARENAS.get(name), Physics(), 1) for name in ("field", "pool")]
    with serving(worlds[0]) as (field, _), serving(worlds[1]) as (pool, _):
        yield {"field": field, "pool": pool}


def pose_in(line):
    """Time and pose of a report of GroundTruth."""
    numbers = re.search(rf"{{Location {VECTOR}}} {{Orientation {VECTOR}}}", line).groups()
    time = float(re.search(r"{Time ([\d.]+)}", line)[1])
    return time, *map(float, numbers)


def ground_truth(peer):
    line = peer.until(b"SEN").decode()
    while "{Type GroundTruth}" not in line:
        line = peer.until(b"SEN").decode()
    return pose_in(line)


def drive(peer, orders):
    """Give orders; return the last ground truth before the server has read them.

    Lines are read in their order, so the reply to the last one says that it has. A client pays for its INIT
    with time in which it is not read, which is long where the world is fast.
    """
    before = ground_truth(peer)
    peer.say("\r\n".join((*orders, "GETCONF {Type Robot}")))
    while not (line := peer.until(b"SEN", b"CONF")).startswith(b"CONF"):
        if b"{Type GroundTruth}" in line:
            before = pose_in(line.decode())
    return before


def test_every_class_of_the_manual_has_a_trip():
    assert {trip.name for trip in TRIPS} >= set(ROBOTS.names()) - {"UnitLoader"}


@pytest.mark.parametrize(
    "trip",
    [
        pytest.param(
            trip,
            marks=pytest.mark.thorough if trip.percents and trip.name != "Hummer" else (),
            id=trip.name + trip.percents * " in percents",
        )
        for trip in TRIPS
    ],
)
def test_a_robot_reports_itself_and_drives(ports, trip):
    robot = ROBOTS.get(trip.name)
    peer = Peer(ports[trip.arena])
    start = f" {{Start {trip.start}}}" if trip.start else ""
    peer.say(f"INIT {{ClassName usarbot.{trip.name.upper()}}} {{Name R1}}{start}")
    status = peer.until(b"STA").decode()
    joints = "".join(rf"{{{name} {F4}}} " for name in robot.reported_joints)
    expected = rf"STA {{Type {trip.kind}}} {{Time [\d.]+}} {STA[trip.kind]}{joints}{HEADLIGHT}"
    assert re.fullmatch(expected, status), status
    peer.say("GETGEO {Type Robot}\r\nGETCONF {Type Robot}")
    geometry, configuration = peer.until(b"GEO").decode(), peer.until(b"CONF").decode()
    assert geometry.startswith(f"GEO {{Type {trip.kind}}} {{Name {trip.name}}} {{Dimensions ")
    head = f"CONF {{Type {trip.kind}}} {{Name {trip.name}}} {{SteeringType {trip.steering}}} "
    assert configuration.startswith(head + f"{{Mass {int(robot.mass)}.")
    began, x0, y0, z0, *_, yaw0 = drive(peer, trip.orders)
    now = began
    while now < began + trip.seconds - ROUNDING:
        now, x, y, z, *_, yaw = ground_truth(peer)
    peer.say("DRIVE {Light True}")
    while b"{LightToggle True} {LightIntensity 100}" not in peer.until(b"STA"):
        pass
    peer.close()
    cos, sin = math.cos(yaw0), math.sin(yaw0)
    forward, right = (x - x0) * cos + (y - y0) * sin, (y - y0) * cos - (x - x0) * sin
    turned = math.remainder(yaw - yaw0, 2 * math.pi)
    for what, value, (low, high) in (
        ("forward", forward, trip.forward),
        ("right", right, trip.right),
        ("down", z - z0, trip.down),
        ("yaw", turned, trip.yaw),
    ):
        assert low <= value <= high, f"{what}: {value:.3f}"


def links_of(peer, package):
    """Where the links of a mission package are (manual 9.3, MISSTA)."""
    line = peer.until(b"MISSTA {Time")
    while f"{{Name {package}}}".encode() not in line:
        line = peer.until(b"MISSTA {Time")
    return {int(n): float(value) for n, value in re.findall(rb"{Link (\d+)} {Value (-?[\d.]+)}", line)}


def test_a_sliding_link_is_told_in_metres(ports):
    """The TeleMax's telescope slides by 0 to 0.3 m; a value beyond is held back."""
    peer = Peer(ports["field"], "INIT {ClassName TeleMax} {Name Slider}")
    peer.say("GETCONF {Type MisPkg}")
    arm = peer.until(b"CONF {Type MisPkg} {Name TeleMaxArm}").decode()
    slider = r"{Link 3} {JointType Prismatic} {MaxSpeed 0.17\d*} .*?{MinRange 0.0+} {MaxRange 0.30*}"
    assert re.search(slider, arm)
    for told, at in ((0.2, 0.2), (0.5, 0.3)):
        peer.say(f"MISPKG {{Name TeleMaxArm}} {{Link 2}} {{Value 2}} {{Link 3}} {{Value {told}}}")
        until = 400
        while until and abs(links_of(peer, "TeleMaxArm")[3] - at) > 5e-3:  # the arm's weight moves it by less
            until -= 1
        assert until, f"told {told} m: {links_of(peer, 'TeleMaxArm')}"
    peer.close()
