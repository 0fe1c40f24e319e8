"""The page of all settings: of trainings, of tasks and of the cells of sweeps, from their declarations."""

from collections.abc import Iterator

from usarmjx.base.settings import rows_of
from usarmjx.base.tables import markdown_table

HEAD = """# All settings

This page is the output of `usarmjx list settings --markdown`; a test keeps it so. `usarmjx train TASK --help`
prints those of one task. `--set NAME=VALUE` and `--config FILE` set them, `--print-config` writes them. The
table of a task has its own fields, and those of all tasks whose default is another one.
"""
COLUMNS = ("setting", "default", "value", "meaning")


def settings_page() -> str:
    """Return tables of all settings, as Markdown."""
    return "\n".join([HEAD, *(f"## {title}\n\n{_table(rows)}\n" for title, rows in _sections())]).rstrip()


def _sections() -> Iterator[tuple[str, list[tuple[str, str, str, str]]]]:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.comms.mail import MessageSettings
    from usarmjx.models.compile.physics import Physics
    from usarmjx.models.compile.randomization import DomainRandomization
    from usarmjx.sweeps.spec import Cell
    from usarmjx.train.envs.recipe import GeneratedArenas
    from usarmjx.train.envs.task import Task
    from usarmjx.train.learning.config import Config
    from usarmjx.train.tasks import TASKS

    yield "Trainings", _rows(Config)
    yield "All tasks", _rows(Task)
    common = {row[0]: row for row in _rows(Task)}
    for name in TASKS.names():
        task = TASKS.get(name)
        yield f"Task {name}", [row for row in _rows(type(task), task) if common.get(row[0]) != row]
    yield "Physics: `physics.NAME`", _rows(Physics)
    yield "Radio: `radio.NAME`", _rows(RadioSettings)
    yield "Messages: `mail.NAME`", _rows(MessageSettings)
    yield "Randomisation: `vary.NAME`", _rows(DomainRandomization)
    yield "Generated arenas", _rows(GeneratedArenas)
    yield "Cells of sweeps", _rows(Cell)


def _rows(kind: type, base: object = None) -> list[tuple[str, str, str, str]]:
    """Return the settings of a class without those of nested ones, which have tables of their own."""
    return [row for row in rows_of(kind, base) if "." not in row[0]]


def _table(rows: list[tuple[str, str, str, str]]) -> str:
    cells = [(f"`{name}`", f"`{default}`", expects, text) for name, expects, default, text in rows]
    return markdown_table(COLUMNS, cells)
