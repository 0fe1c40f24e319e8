"""Tables of robots, sensors and engines: the texts of `usarmjx list` and of two generated pages.

Importing this imports JAX: commands import it once they have written their first line.
"""

import dataclasses
import importlib.util
import inspect
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from usarmjx.base.installation import install_command
from usarmjx.base.settings.files import is_tuple
from usarmjx.base.tables import markdown_table
from usarmjx.engines import ENGINES, choose_engine
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, Options, RobotSpec, manual_keys, options
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, Sensor, SensorSettings, total_size
from usarmjx.sensors.suite import Suite, suite_of
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.grammar import format_message as line_of
from usarmjx.server.protocol.reports import sen_objects

FIGURES = (
    "class", "type, steering", "L x W x H [m]", "mass [kg]", "payload [kg]", "top speed [m/s]",
    "DRIVE keys (largest value)", "figures from",
)  # fmt: skip
EQUIPMENT = "class", "wheels and other joints", "mission packages", "sensors", "cameras", "effecters"
TABLE_HEAD = """# All robots

This page is the output of `usarmjx list robots --markdown`; a test keeps it so. The last column is
the source of each figure: the manual's section, lines captured from a real server, the machine's data sheet,
or chosen by us because nothing was found. Measurements of the built robots are in [robots.md](robots.md).
The top speed of a flying robot is that of all its speeds at once: 2 m/s ahead and 2 m/s up (manual 12.21)
make 2.83 m/s for a Passarola.

![All robots, drawn by `usarmjx portraits`](robots.png)
"""


def robots_table() -> str:
    """Return a Markdown page with all robot classes: figures with their sources, and equipment."""
    figures, equipment = list[Sequence[object]](), list[Sequence[object]]()
    for name, robot in ROBOTS:
        drive = robot.drive
        keys = ", ".join(f"{key} {value:.4g}" for key, value in drive.full_scale.items()) or "-"
        size = " x ".join(f"{side:.3g}" for side in robot.dimensions)
        sources = "; ".join(f"{field}: {source}" for field, source in robot.sources)
        figures.append(
            (
                name,
                f"{drive.vehicle}, {drive.steering}",
                size,
                f"{robot.mass:g}",
                f"{robot.payload:g}",
                f"{drive.top_speed:.2f}",
                keys,
                sources,
            )
        )
        equipment.append(
            (
                name,
                _joints(robot),
                _packages(robot),
                sensor_names(robot),
                _names(robot.cameras),
                _names(robot.effecters),
            )
        )
    return "\n".join([TABLE_HEAD, markdown_table(FIGURES, figures), "", markdown_table(EQUIPMENT, equipment)])


def _names(mounts: Sequence[Mount]) -> str:
    return ", ".join(mount.name for mount in mounts) or "-"


def _joints(robot: RobotSpec) -> str:
    others = [part.name for part in robot.parts if not part.is_wheel and part.motor is not None]
    return ", ".join([f"{len(robot.wheels)} wheels"] * bool(robot.wheels) + others) or "-"


def _packages(robot: RobotSpec) -> str:
    return ", ".join(f"{package.name} ({len(package.links)})" for package in robot.packages) or "-"


def sensor_names(robot: RobotSpec) -> str:
    """Return the types of a robot's sensors, with how many there are of each."""
    kinds = [
        f"{len(sensor.mounts)} {sensor.kind}" if len(sensor.mounts) > 1 else sensor.kind
        for sensor in suite_of(robot).sensors
    ]
    return ", ".join(kinds) or "-"


def catalogue() -> str:
    """Return robots, arenas, sensor types, tasks, policies and engines, one line each."""
    from usarmjx.train.policies import POLICIES
    from usarmjx.train.tasks import TASKS

    lines = ["Robots (INIT {ClassName USARBot.<name>}):"]
    for name, robot in ROBOTS:
        length, width, height = robot.dimensions
        lines.append(
            f"  {name:10} {length:.2f} x {width:.2f} x {height:.2f} m, {robot.mass:g} kg, "
            f"{robot.drive.top_speed:.2f} m/s"
        )
        lines.append(f"  {'':10} {sensor_names(robot)}")
    lines.append("Arenas:")
    for name, arena in ARENAS:
        aliases = f" ({', '.join(arena.aliases)})" if arena.aliases else ""
        lines.append(f"  {name}{aliases}: {len(arena.shapes)} solids, {len(arena.starts)} start poses")
    lines.append(f"Sensors: {', '.join(SENSORS.names())}")
    lines.append(f"Tasks: {', '.join(TASKS.names())}")
    lines.append(f"Trained policies: {', '.join(POLICIES.names())}")
    lines.append("Engines:")
    for name, _ in ENGINES:
        lines.append(f"  {name:5} {availability(name)}")
    lines.append(
        f"  auto is {choose_engine('auto', 'serve')} for serve, {choose_engine('auto', 'batch')} for bench"
    )
    return "\n".join(lines)


def availability(engine: str) -> str:
    """Return the devices of an engine here, or why it cannot run."""
    if engine == "warp" and importlib.util.find_spec("warp") is None:
        return f"not installed: {install_command('cuda')} (NVIDIA GPU), or extra warp (CPU, slow)"
    where = {
        "c": "CPU, one world after the other",
        "jax": "JAX's default device",
        "warp": "NVIDIA GPU; slow on a CPU",
    }
    devices = f"; JAX sees {jax.devices()[0].device_kind}" if engine == "jax" else ""
    return where.get(engine, "on JAX's default device") + devices


OPTION_HEAD = "type", "options, and their values without a mount or an ini file that sets them"
SENSORS_HEAD = """# All sensors

This page is the output of `usarmjx list sensors --markdown`; a test keeps it so. [sensors.md](sensors.md)
has examples. Rays are those of one sensor with the options below; "from" is the manual's section, or
lines captured from a real server, or ours where USARSim has none. A value has the leading axes worlds and
robots.
"""
MESSAGES = """Their messages over TCP; those of the scanners have fewer beams here:
"""
ROBOTS_NAMED = 3
"""Number of robots named."""
MESSAGE_TIME = 62.01
"""Of the messages shown [s]."""
SECTIONS = {
    "Sonar": "10.2",
    "IR": "10.2",
    "RangeScanner": "10.3",
    "IRScanner": "10.3",
    "RangeScanner3D": "12.17.2",
    "Odometry": "10.4",
    "GPS": "10.5",
    "INS": "10.6",
    "INU": "12.12, 13.3",
    "Encoder": "10.7",
    "Touch": "10.8",
    "RFID": "10.9",
    "VictSensor": "10.10",
    "Sound": "10.11",
    "HumanMotion": "10.12",
    "GroundTruth": "captured",
    "CO2Sensor": "captured",
    "Lidar": "ours",
    "IMU": "ours",
    "Magnetometer": "ours",
    "Battery": "ours",
    **dict.fromkeys(
        (
            *("Tachometer", "AltitudeSensor", "MissionTime", "AHRS", "MagneticCompass"),
            *("LineLaser", "Kinect", "ObjectSensor", "PCL"),
        ),
        "later versions",
    ),
}
"""Source of each: a section of the manual, messages of real servers, or neither."""
SAMPLES = {
    "Sonar": [1.7626],
    "IR": [0.8569],
    "RangeScanner": [11.3059, 20.0, 0.5],
    "IRScanner": [11.3059, 20.0],
    "RangeScanner3D": [[4.0, 4.1], [1.5, 1.6]],
    "Odometry": [0.6168, 0.0014, 0.0027],
    "GPS": [12.6, 2.5, 12.0],
    "INS": [4.5, -1.9, -1.8, 0.0, 0.0, -1.57],
    "INU": [4.5, -1.9, -1.8, 0.0, 0.0, -1.57],
    "GroundTruth": [4.5, -1.9, -1.8, 0.0, 0.0, -1.57],
    "Encoder": [211.0],
    "Touch": [1.0],
    "RFID": [[1.0, 1001.0, 1.5, -0.5, -0.26]],
    "VictSensor": [[1.0, 0.0, 1.71, -0.25, -0.02]],
    "Sound": [1.65, 2.0],
    "HumanMotion": 0.66,
    "CO2Sensor": 0.01,
    "Lidar": [[[4.0, 4.1], [1.5, 100.0]], [[0.48, 0.46], [0.21, 0.0]]],
    "IMU": [0.01, 0.0, 0.52, 0.12, 0.02, 9.79],
    "Magnetometer": [20.5, -0.3, -43.4],
    "Battery": [0.75, 23.85, 2700.0],
    "Tachometer": [3.0, -3.0, 3.0, -3.0, 12.5, -7.1, 12.4, -7.0],
    "AltitudeSensor": [1.25, 112.25],
    "MissionTime": [4.0],
    "AHRS": [0.12, 0.0, 0.02, 0.0, 0.01, 0.52, 0.0, 0.0, 0.1, 0.0, 0.02, -1.57],
    "MagneticCompass": [1.57],
    "LineLaser": [[4.5, -1.9, 0.3], [0.0, 0.0, -1.57], [5.5, -2.9, 0.3], [4.5, -2.9, 0.3]],
    "Kinect": [12.0, 1.234, 3.0],
    "ObjectSensor": [3.2, 4.0],
    "PCL": [[3.2, 1.1, -0.9], [4.0, -1.4, -1.1]],
}
"""Values in our axes, of one mount."""
SHORT_OPTIONS = {
    "RangeScanner": options(Resolution=1.5707, ScanFov=3.1415),
    "IRScanner": options(Resolution=1.5707, ScanFov=3.1415),
    "RangeScanner3D": options(
        VerticalFOV=0.2, VerticalResolution=0.2, HorizontalFOV=0.5, HorizontalResolution=0.5
    ),
    "ObjectSensor": options(Resolution=1.5707, ScanFov=3.1415),
    "Lidar": options(VerticalFOV=0.2, VerticalResolution=0.2, HorizontalFOV=0.5, HorizontalResolution=0.5),
}
"""Options with which the messages shown are short."""


def suite_with(kind: str, given: Options = ()) -> Suite:
    """Return the sensors of a P2AT that has only one, of that type."""
    mount = Mount(kind=kind, name=kind, options=given)
    if kind == "Encoder":
        # An encoder counts the turns of a joint, so it needs one.
        mount = replace(mount, parent="LeftFWheel")
    return suite_of(replace(P2AT, name=f"P2AT with {kind}", sensors=(mount,)))


def describe(sensor: type[Sensor]) -> tuple[str, str]:
    """Return the function of a type of sensor and its value, from its docstring."""
    first = inspect.cleandoc(sensor.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    # Docstrings of sensors have this form, as docs/own-sensor.md shows.
    what, _, value = first.rstrip(".").partition("; value: ")
    return what, value


def ini_value(value: object) -> str:
    """Return a value as an ini file has it; angles and lengths are radians and metres."""
    if is_tuple(value):
        return "(" + ",".join(f"{key}={number:g}" for key, number in value) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def own_options(settings: type) -> str:
    """Return the options of a type with their defaults, without those that it has as others do."""
    is_noisy = issubclass(settings, NoisySensorSettings)
    usual, own = defaults_of(NoisySensorSettings if is_noisy else SensorSettings), defaults_of(settings)
    # No default is an Ellipsis: what others lack always differs.
    own = {key: value for key, value in own.items() if usual.get(key, ...) != value}
    return ini_text(own) or "-"


def defaults_of(settings: type) -> dict[str, object]:
    """Return the defaults of settings by the manual's keys."""
    keys = manual_keys(settings)
    return {keys[field.name]: field.default for field in dataclasses.fields(settings)}


def ini_text(values: dict[str, object]) -> str:
    """Return settings by key as an ini file has them."""
    return ", ".join(f"{key}={ini_value(value)}" for key, value in values.items())


def sample_message(kind: str) -> str:
    """Return a message of a type of sensor."""
    if kind == "ObjectSensor":  # its objects are the world's
        return line_of(sen_objects(None, kind, [("crate", (1.5, -0.2, -0.1), (0.0, 0.0, 0.3))]))
    (sensor,) = suite_with(kind, SHORT_OPTIONS.get(kind, ())).sensors
    # Zeros in the right number: the message then shows its form at least.
    numbers = SAMPLES.get(kind, np.zeros(max(1, total_size(sensor.quantities))))
    # In single precision, as sensors deliver their values: rounding shows as on the wire.
    message = sensor_report(sensor, np.array(numbers, np.float32), MESSAGE_TIME)
    return "" if message is None else line_of(message)


def robots_with(kind: str) -> str:
    """Return the robots that have sensors of a type."""
    names = [name for name, robot in ROBOTS if any(mount.kind == kind for mount in robot.sensors)]
    more = len(names) - ROBOTS_NAMED
    return ", ".join(names[:ROBOTS_NAMED]) + (f" and {more} more" if more > 0 else "") or "-"


def sensors_table() -> str:
    """Return a Markdown page of all types of sensors: what they do, their options, their messages."""
    # The manual's types in its order; types that a program has registered come behind them.
    kinds = [kind for kind in SECTIONS if kind in SENSORS]
    kinds += [kind for kind in SENSORS.names() if kind not in kinds]
    rows = list[Sequence[object]]()
    for kind in kinds:
        what, value = describe(SENSORS.get(kind))
        (rays,) = suite_with(kind).ray_counts
        source = SECTIONS.get(kind, "own")
        rows.append((kind, what, value, rays or "-", robots_with(kind), source))
    head = "type", "function", "value in a batch", "rays", "robots", "from"
    settings = {kind: SENSORS.get(kind).settings_class for kind in kinds}
    noisy = ", ".join(kind for kind, own in settings.items() if issubclass(own, NoisySensorSettings))
    common, noise = defaults_of(SensorSettings), defaults_of(NoisySensorSettings)
    options = [
        ("all", ini_text(common)),
        (noisy, ini_text({name: noise[name] for name in noise if name not in common})),
        *((kind, own_options(own)) for kind, own in settings.items()),
    ]
    tables = [markdown_table(head, rows), "", markdown_table(OPTION_HEAD, options), ""]
    return "\n".join([SENSORS_HEAD, *tables, MESSAGES, "```text", *map(sample_message, kinds), "```"])
