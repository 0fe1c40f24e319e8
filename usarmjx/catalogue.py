"""What there is: the text of `usarmjx list`."""

import importlib.util

import jax

from usarmjx.engines import ENGINES, choose_engine
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.suite import suite_of


def catalogue() -> str:
    """Return a listing of robots, arenas, sensor types and engines, one line each."""
    lines = ["Robots (INIT {ClassName USARBot.<name>}):"]
    for name, robot in ROBOTS:
        length, width, height = robot.dimensions
        sensors = ", ".join(
            f"{len(s.mounts)} {s.kind}" if len(s.mounts) > 1 else s.kind for s in suite_of(robot).sensors
        )
        speed = robot.drive.top_speed
        lines.append(
            f"  {name:10} {length:.2f} x {width:.2f} x {height:.2f} m, {robot.mass:g} kg, {speed:.2f} m/s"
        )
        lines.append(f"  {'':10} {sensors}")
    lines.append("Arenas:")
    for name, arena in ARENAS:
        aliases = f" ({', '.join(arena.aliases)})" if arena.aliases else ""
        lines.append(f"  {name}{aliases}: {len(arena.shapes)} solids, {len(arena.starts)} start poses")
    lines.append(f"Sensors: {', '.join(SENSORS.names())}")
    lines.append("Engines:")
    for name, _ in ENGINES:
        lines.append(f"  {name:5} {_availability(name)}")
    lines.append(
        f"  auto is {choose_engine('auto', 'serve')} for serve, {choose_engine('auto', 'train')} for bench"
    )
    return "\n".join(lines)


def _availability(engine: str) -> str:
    if engine == "warp" and importlib.util.find_spec("warp") is None:
        return "not installed: pip install usarmjx[cuda] (NVIDIA GPU) or usarmjx[warp] (CPU, slow)"
    where = {
        "c": "CPU, one world after the other",
        "jax": "JAX's default device",
        "warp": "NVIDIA GPU; slow on a CPU",
    }
    devices = f"; JAX sees {jax.devices()[0].device_kind}" if engine == "jax" else ""
    return where[engine] + devices
