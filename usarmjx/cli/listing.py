"""`usarmjx list`: what robots, sensors, arenas, tasks, policies and engines there are."""

import dataclasses
import importlib.util
import inspect
import json
import json as json_format
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated, Any

import jax
import numpy as np
import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.markdown import markdown_table
from usarmjx.cli.common import ErrorExit, IniOption, JsonFlag, UnitOption, configure_from
from usarmjx.cli.completion import complete_listings
from usarmjx.cli.startup_messages import announce
from usarmjx.engines import ENGINES, choose_engine
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, Options, RobotSpec, options
from usarmjx.models.types.settings import manual_keys
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, Sensor, SensorSettings, total_size
from usarmjx.sensors.suite import Suite, suite_of
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.grammar import format_message as line_of

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


COMMANDS_HEAD = """## All options

From here on this page is the output of `usarmjx list commands --markdown`; a test keeps it so.
"""


def commands_page(app: typer.Typer) -> str:
    """Return a table of options for each command, as Markdown."""
    parts = [COMMANDS_HEAD]
    for path, command in commands_of(app):
        cells = [(names, _plain(what), default) for names, what, default in options_of(command)]
        about = _first_paragraph(command.help or "")
        table = ["", markdown_table(("option", "what", "unless given"), cells)] if cells else []
        parts.append("\n".join([f"### usarmjx {path}", "", about, *table, ""]))
    return "\n".join(parts).rstrip()


def commands_json(app: typer.Typer) -> str:
    """Return all commands as a JSON list."""
    columns = "option", "what", "default"
    whole = [
        {
            "command": path,
            "what": _first_paragraph(command.help or ""),
            "options": [dict(zip(columns, row, strict=True)) for row in options_of(command)],
        }
        for path, command in commands_of(app)
    ]
    return json.dumps(whole, indent=1)


def commands_of(app: typer.Typer) -> Iterator[tuple[str, Any]]:
    """Yield the commands by what one types, and sub-commands in their places."""
    root: Any = typer.main.get_command(app)
    yield from _below(root, "")


def _below(group: Any, path: str) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - click's, or typer's own copy
    for name in sorted(group.commands):
        command = group.commands[name]
        if hasattr(command, "commands"):
            yield from _below(command, f"{path}{name} ")
        elif not command.hidden:
            yield f"{path}{name}", command


def options_of(command: Any) -> list[tuple[str, str, str]]:  # noqa: ANN401 - click's, or typer's own copy
    """Return names, help and default of a command's arguments and options, those in no help left out."""
    rows: list[tuple[str, str, str]] = []
    for one in command.params:
        if getattr(one, "hidden", False) or one.name == "help":
            continue
        if one.param_type_name == "argument":
            names = (one.metavar or one.name.upper()).strip("[].") + (" ..." if one.nargs < 0 else "")
        else:
            names = f"`{', '.join([*one.opts, *one.secondary_opts])}`"
        what = " ".join((one.help or "").split())
        rows.append((names, what, _default(one)))
    return rows


def _plain(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return text.replace("<", "&lt;")


def _default(parameter: Any) -> str:  # noqa: ANN401 - click's, or typer's own copy
    """Return what a parameter is unless given, as one would type it."""
    value = parameter.default
    if parameter.required:
        return "needed"
    if value is None or value is False or value == [] or "Sentinel" in type(value).__name__:
        return ""
    if value is True:
        return f"`{parameter.opts[0]}`"
    return f"`{', '.join(map(str, value)) if isinstance(value, list) else value}`"


def _first_paragraph(text: str) -> str:
    return " ".join(inspect.cleandoc(text).split("\n\n")[0].split()).replace("\f", "")


OPTION_HEAD = "type", "options, and what they are unless a mount or an ini file says otherwise"
SENSORS_HEAD = """# All sensors

This page is the output of `usarmjx list sensors --markdown`; a test keeps it so. [sensors.md](sensors.md)
tells how to use them. Rays are those of one sensor with the options below; "from" is the manual's section, or
lines captured from a real server, or ours where USARSim has none. A value has the leading axes worlds and
robots.
"""
MESSAGES = """What they say over TCP; those of the scanners are with fewer beams:
"""
ROBOTS_NAMED = 3
"""So many robots are named."""
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
}
"""Where each is from: a section of the manual, messages of real servers, or what is in neither."""
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
}
"""Values in our axes, of one mount."""
SHORT_OPTIONS = {
    "RangeScanner": options(Resolution=1.5707, ScanFov=3.1415),
    "IRScanner": options(Resolution=1.5707, ScanFov=3.1415),
    "RangeScanner3D": options(
        VerticalFOV=0.2, VerticalResolution=0.2, HorizontalFOV=0.5, HorizontalResolution=0.5
    ),
    "Lidar": options(VerticalFOV=0.2, VerticalResolution=0.2, HorizontalFOV=0.5, HorizontalResolution=0.5),
}
"""Options with which the messages shown are short."""


def suite_with(kind: str, given: Options = ()) -> Suite:
    """Return the sensors of a P2AT that has only one, of that type."""
    mount = Mount(kind=kind, name=kind, options=given)
    if kind == "Encoder":
        mount = replace(mount, parent="LeftFWheel")
    return suite_of(replace(P2AT, name=f"P2AT with {kind}", sensors=(mount,)))


def describe(sensor: type[Sensor]) -> tuple[str, str]:
    """Return what a type of sensor does, and what its value is, as its docstring tells."""
    first = inspect.cleandoc(sensor.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    what, _, value = first.rstrip(".").partition("; value: ")
    return what, value


def ini_value(value: object) -> str:
    """Return a value as an ini file has it; angles and lengths are radians and metres."""
    if isinstance(value, tuple):
        return "(" + ",".join(f"{key}={number:g}" for key, number in value) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def own_options(settings: type) -> str:
    """Return the options of a type with their defaults, without those that it has as others do."""
    usual = defaults_of(NoisySensorSettings if issubclass(settings, NoisySensorSettings) else SensorSettings)
    own = {key: value for key, value in defaults_of(settings).items() if usual.get(key, ...) != value}
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
    (sensor,) = suite_with(kind, SHORT_OPTIONS.get(kind, ())).sensors
    numbers = SAMPLES.get(kind, np.zeros(max(1, total_size(sensor.quantities))))
    message = sensor_report(sensor, np.array(numbers, np.float32), MESSAGE_TIME)
    return "" if message is None else line_of(message)


def robots_with(kind: str) -> str:
    """Return the robots that have sensors of a type."""
    names = [name for name, robot in ROBOTS if any(mount.kind == kind for mount in robot.sensors)]
    more = len(names) - ROBOTS_NAMED
    return ", ".join(names[:ROBOTS_NAMED]) + (f" and {more} more" if more > 0 else "") or "-"


def sensors_table() -> str:
    """Return a Markdown page of all types of sensors: what they do, their options, their messages."""
    kinds = [kind for kind in SECTIONS if kind in SENSORS]
    kinds += [kind for kind in SENSORS.names() if kind not in kinds]
    rows = list[Sequence[object]]()
    for kind in kinds:
        what, value = describe(SENSORS.get(kind))
        (rays,) = suite_with(kind).ray_counts
        source = SECTIONS.get(kind, "own")
        rows.append((kind, what, value, rays or "-", robots_with(kind), source))
    head = "type", "what it does", "value in a batch", "rays", "robots", "from"
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


EVERYTHING, COMMANDS = "everything", "commands"
MarkdownFlag = Annotated[bool, typer.Option("--markdown", help="Print Markdown, as the documents have it.")]


def list_everything(
    what: Annotated[
        str,
        typer.Argument(
            help="robots, sensors, arenas, tasks, policies, engines, commands, or everything in brief.",
            autocompletion=complete_listings,
        ),
    ] = EVERYTHING,
    json: JsonFlag = False,
    markdown: MarkdownFlag = False,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
) -> None:
    """List robots, sensors, arenas, tasks, policies, engines: a table on a terminal, lines in a pipe."""
    with ErrorExit():
        check_form(json, markdown)
        announce("reading what there is ...")
        configure_from(ini, uu_per_metre)
        from usarmjx.cli.tables import LISTINGS

        if what not in (EVERYTHING, COMMANDS, *LISTINGS):
            known = ", ".join((EVERYTHING, *LISTINGS, COMMANDS))
            raise UsageError(f"cannot list {what!r}; there is: {known}")
        if what == EVERYTHING:
            _list_all(json, markdown)
        else:
            show_listing(what, json, markdown)


def check_form(json: bool, markdown: bool) -> None:
    """Refuse two forms at once.

    Raises:
        UsageError: Both are asked for.
    """
    if json and markdown:
        raise UsageError("give either --json or --markdown")


def show_listing(what: str, json: bool, markdown: bool) -> None:
    """Print one listing in the form that is asked for; else a table on a terminal, plain text elsewhere."""
    from usarmjx.cli.tables import LISTINGS

    if what == COMMANDS:
        from usarmjx.cli.app import app

        pass  # REMOVED_IMPORT

        typer.echo(commands_json(app) if json else commands_page(app))
        return
    if markdown:
        typer.echo(_page(what))
        return
    listing = LISTINGS[what]()
    if json:
        typer.echo(listing.as_json())
    elif sys.stdout.isatty():
        from rich.console import Console

        listing.show(Console())
    else:
        typer.echo(listing.as_text())


def _page(what: str) -> str:
    """Return what the documents have of a listing: of some more than its table."""
    from usarmjx.cli.arena import arenas_table
    from usarmjx.cli.tables import LISTINGS

    pages = {"robots": robots_table, "sensors": sensors_table, "arenas": arenas_table}
    return pages[what]() if what in pages else LISTINGS[what]().as_markdown()


def _list_all(json: bool, markdown: bool) -> None:
    from usarmjx.cli.tables import LISTINGS

    if json:
        whole = {name: json_format.loads(make().as_json()) for name, make in LISTINGS.items()}
        typer.echo(json_format.dumps(whole, indent=1))
    elif markdown:
        typer.echo("\n\n".join(f"## {make().title}\n\n{make().as_markdown()}" for make in LISTINGS.values()))
    else:
        typer.echo(catalogue())
