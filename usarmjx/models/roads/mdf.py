"""Mission data files (MDF) of the DARPA Urban Challenge: text to data and back; see `rndf`."""

from functools import partial
from pathlib import Path

from usarmjx.base.errors import SpecError
from usarmjx.models.roads.lines import RoadLines, Row, written
from usarmjx.models.roads.network import FASTEST, Mission, RouteNetwork, SpeedLimit, mission_faults


def read_mdf(source: str | Path, network: RouteNetwork | None = None) -> Mission:
    """Return the mission of a file.

    Args:
        source: Its path, or its text: a string with a line break.
        network: Its route network; with it, checkpoints and numbers of segments are checked too.

    Raises:
        SpecError: It does not follow the format, its speed limits are turned round, or its network has not
            what it refers to; the message names file and line, what was wrong and what is allowed.
    """
    lines = RoadLines(source)
    name = lines.text("MDF_name")
    rndf = lines.text("RNDF")
    head: dict[str, str] = {}

    def note(keyword: str) -> None:
        head[keyword] = lines.text(keyword)

    lines.header({keyword: partial(note, keyword) for keyword in ("format_version", "creation_date")})
    checkpoints = _checkpoints(lines) if lines.word == "checkpoints" else ()
    limits = _speed_limits(lines) if lines.word == "speed_limits" else ()
    if lines.word != "end_file":
        raise lines.unexpected("format_version", "creation_date", "checkpoints", "speed_limits", "end_file")
    lines.take("end_file")
    mission = Mission(name=name, rndf=rndf, checkpoints=checkpoints, speed_limits=limits, **head)
    lines.refuse(mission_faults(mission, network))
    return mission


def _checkpoints(lines: RoadLines) -> tuple[int, ...]:
    lines.take("checkpoints")
    (announced,) = lines.numbers("num_checkpoints")
    found: list[int] = []
    while lines.numbered:
        (number,) = lines.parsed(lines.word, 1, lines.line)
        lines.fault_lines.setdefault(("checkpoint", number), lines.line)
        lines.words(0)
        found.append(number)
    lines.count(len(found), announced, "checkpoints")
    lines.take("end_checkpoints")
    return tuple(found)


def _speed_limits(lines: RoadLines) -> tuple[SpeedLimit, ...]:
    lines.take("speed_limits")
    (announced,) = lines.numbers("num_speed_limits")
    found: list[SpeedLimit] = []
    while lines.numbered:
        line = lines.line
        (number,) = lines.parsed(lines.word, 1, line)
        lines.fault_lines["speed_limit", number] = line
        low, high = (lines.real(w, "speed", 0.0, FASTEST, line) for w in lines.words(2, "lowest highest"))
        found.append(SpeedLimit(id=number, low=low, high=high))
    lines.count(len(found), announced, "speed limits")
    lines.take("end_speed_limits")
    return tuple(found)


def write_mdf(mission: Mission) -> str:
    """Return the text of a mission's file; `read_mdf` returns the same mission for it.

    Raises:
        SpecError: The mission is not sound (`mission_faults`), or a file cannot hold one of its names.
    """
    for _, text in mission_faults(mission):
        raise SpecError(f"{mission.name}: {text}")
    rows: list[Row] = [
        ("MDF_name", mission.name),
        ("RNDF", mission.rndf),
        ("format_version", mission.format_version),
        ("creation_date", mission.creation_date),
        ("checkpoints",),
        ("num_checkpoints", len(mission.checkpoints)),
        *((number,) for number in mission.checkpoints),
        ("end_checkpoints",),
        ("speed_limits",),
        ("num_speed_limits", len(mission.speed_limits)),
        *((limit.id, limit.low, limit.high) for limit in mission.speed_limits),
        ("end_speed_limits",),
        ("end_file",),
    ]
    return written(rows)
