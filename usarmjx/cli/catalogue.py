"""What there is: the text of `usarmjx list`."""

import importlib.util
from collections.abc import Sequence

import jax

from usarmjx.base.markdown import markdown_table
from usarmjx.engines import ENGINES, choose_engine
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.robot import Mount, RobotSpec
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.suite import suite_of

FIGURES = (
    "class", "type, steering", "L x W x H [m]", "mass [kg]", "payload [kg]", "top speed [m/s]",
    "DRIVE keys (largest value)", "figures from",
)  # fmt: skip
EQUIPMENT = "class", "wheels and other joints", "mission packages", "sensors", "cameras", "effecters"
TABLE_HEAD = """# All robots

This page is the output of `usarmjx list robots --markdown`; a test keeps it so. The last column says where
each figure is from: the manual's section, lines captured from a real server, the machine's data sheet, or
chosen by us because nothing was found. What was measured on the built robots is in [robots.md](robots.md).

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
    """Return where an engine runs, or why it does not here."""
    if engine == "warp" and importlib.util.find_spec("warp") is None:
        return "not installed: pip install usarmjx[cuda] (NVIDIA GPU) or usarmjx[warp] (CPU, slow)"
    where = {
        "c": "CPU, one world after the other",
        "jax": "JAX's default device",
        "warp": "NVIDIA GPU; slow on a CPU",
    }
    devices = f"; JAX sees {jax.devices()[0].device_kind}" if engine == "jax" else ""
    return where.get(engine, "on JAX's default device") + devices
