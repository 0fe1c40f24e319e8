"""`usarmjx robot`: look at robots from files."""

import json as json_format
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from usarmjx.base.settings import parse_assignments
from usarmjx.cli.common import ErrorExit, JsonFlag, PackagesOption, PiecesOption, announce, named
from usarmjx.cli.known_names import complete_robots

if TYPE_CHECKING:
    from usarmjx.models.types.robot import Motor, Part, RobotSpec

app = typer.Typer(help="Check robots from files: URDF, xacro, SDF, MJCF.", no_args_is_help=True)


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="URDF, xacro, SDF or MJCF file of a robot.")],
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
    argument: Annotated[
        list[str] | None, typer.Option("--argument", help="Argument of a xacro file, as name=value.")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="Write a picture of the robot to this PNG file.")] = None,
    json: JsonFlag = False,
) -> None:
    """Print the robot of a file, and the parts that are left out; exit code 1 if it does not stand."""
    with ErrorExit():
        announce(f"reading {file} ...")
        from usarmjx.models.check import robot_faults
        from usarmjx.models.files.find_robot import check_robot_file
        from usarmjx.models.files.robot_file import load_robot

        check_robot_file(file)
        given = parse_assignments(argument or (), "--argument")
        loaded = load_robot(file, arguments=given)
        faults = robot_faults(loaded.robot)
        rows = robot_figures(loaded.robot)
        if json:
            whole = {**rows, "left out or mended": list(loaded.notes), "faults": faults}
            typer.echo(json_format.dumps(whole, indent=1))
        else:
            for name, value in rows.items():
                typer.echo(f"{name:<12} {_shown(value)}")
            for note in loaded.notes:
                typer.echo(f"note         {note}")
            for fault in faults:
                typer.echo(f"fault        {fault}")
        if png is not None:
            from usarmjx.plots.gallery import portraits

            portraits([loaded.robot], png)
            # The standard output has the JSON alone.
            typer.echo(f"wrote {png}", err=json)
        if faults:
            raise typer.Exit(1)


@app.command()
def export(
    robot: Annotated[
        str,
        typer.Argument(
            help="Name of a robot class, or a robot's file.",
            autocompletion=complete_robots,
            callback=named("robot"),
        ),
    ],
    out: Annotated[Path, typer.Option(help="File to write; meshes are written beside it.")],
    form: Annotated[
        str | None, typer.Option("--format", help="mjcf, urdf or sdf; else by the file's suffix.")
    ] = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Write a robot as MJCF, URDF or SDF, with the mass, solids and joints that it has here."""
    with ErrorExit():
        announce(f"building {robot} ...")
        from usarmjx.models.files.find_robot import find_robot
        from usarmjx.models.files.robot_export import SUFFIXES, export_robot

        by_suffix = {suffix: name for name, suffix in SUFFIXES.items()}
        # An unknown suffix passes for a format's name: `export_robot` refuses it and lists the formats.
        result = export_robot(find_robot(robot), out, form or by_suffix.get(out.suffix.lower(), out.suffix))
        for note in result.notes:
            typer.echo(f"note: {note}", err=True)
        typer.echo(f"wrote {', '.join(map(str, result.files))}")


def robot_figures(robot: "RobotSpec") -> dict[str, Any]:
    """Return the figures of a robot by their names, with units."""
    length, width, height = robot.dimensions
    motors = {part.name: _motor(part, part.motor) for part in robot.parts if part.motor is not None}
    figures: dict[str, Any] = {
        "class": robot.name,
        "mass": f"{robot.mass:.4g} kg",
        "size": f"{length:.3f} x {width:.3f} x {height:.3f} m",
        "origin": f"{robot.origin_height:.3f} m above the ground",
        "drive": _drive(robot),
    }
    if robot.wheels:
        names = ", ".join(part.name for part in robot.wheels)
        figures["wheels"] = (
            f"{names}; radius {robot.wheel_radius:.4f} m, {robot.wheel_separation:.3f} m apart, "
            f"wheel base {robot.wheel_base:.3f} m"
        )
    figures["motors"] = [*motors.values()]
    figures["joints"] = [part.name for part in robot.parts if part.name not in motors]
    figures["sensors"] = [f"{mount.kind} {mount.name}" for mount in (*robot.sensors, *robot.cameras)]
    return figures


def _drive(robot: "RobotSpec") -> str:
    from usarmjx.models.drives import NoDrive

    if isinstance(robot.drive, NoDrive):
        return "none: no plugin states one, no wheels are on both sides, no rotors are on sites"
    return f"{type(robot.drive).__name__}, up to {robot.drive.top_speed:.3g} m/s"


def _motor(part: "Part", motor: "Motor") -> str:
    effort, speed = ("N m", "rad/s") if part.joint == "hinge" else ("N", "m/s")
    return f"{part.name} {motor.torque:.3g} {effort}, {motor.max_speed:.3g} {speed}"


def _shown(value: str | list[str] | Mapping[str, str]) -> str:
    return value if isinstance(value, str) else ("; ".join(value) or "none")
