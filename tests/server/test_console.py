"""The spectator's console: what its lines do, who may use which, and what a wrong one is told."""

import logging
from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.server.still_world import CLASS, StillWorld
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots import ROBOTS
from usarmjx.server.runtime.logs import MAX_KEPT_LINES, MAX_LOG_LINE, PACKAGE, LogTail, keep_log
from usarmjx.server.viewing.console import NOT_ALLOWED, SpectatorCamera, SpectatorConsole
from usarmjx.view.controls import WorldStatus


@dataclass
class Controls:
    """Controls that remember whether worlds stand still; no test asks anything else of them."""

    paused: bool = False
    asked: list[int] = field(default_factory=list)

    def status(self, world):
        self.asked.append(world)
        return WorldStatus(time=0.0, realtime_factor=0.97, paused=self.paused)

    def pause(self, on):
        self.paused = on


@pytest.fixture
def world():
    world = StillWorld()
    world.spawn(ROBOTS.get(CLASS), "R1", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return world


@pytest.fixture
def package():
    """The package's logger, as it was before when the test is over."""
    logger, root = logging.getLogger(PACKAGE), logging.getLogger()
    before = logger.level, list(logger.handlers), list(root.handlers)
    yield logger
    logger.setLevel(before[0])
    logger.handlers[:], root.handlers[:] = before[1], before[2]


def test_pause_lets_the_world_stand_still_and_go_on(world):
    controls = Controls()
    console = SpectatorConsole(world, controls, number=3)
    assert (console.run("pause"), controls.paused) == ("it stands still", True)
    assert ", paused" in console.run("showdebug")
    assert (console.run("PAUSE"), controls.paused) == ("it goes on", False)
    assert set(controls.asked) == {3}
    assert "nothing here can make this world stand still" in SpectatorConsole(world).run("pause")


def test_showdebug_has_the_camera_as_init_wants_it(world):
    """On the wire y is to the right and z down, and so are the angles."""
    camera = SpectatorCamera(np.array([1.0, 2.0, 3.0]), mat_from_angles(0.0, 0.25, 0.5), 12.34, "free view")
    world.step()
    told = SpectatorConsole(world, Controls(), camera=lambda: camera).run("showdebug").splitlines()
    assert told == [
        "camera: {Location 1.00,-2.00,-3.00} {Rotation 0.00,-0.25,-0.50}",
        "free view, 12.3 pictures a second",
        "flat at 0.02 s, real-time factor 0.97",
        f"robots: R1 ({CLASS})",
    ]
    assert SpectatorConsole(world).run("showdebug").startswith("flat at")


def test_showlog_shows_the_last_lines_of_the_log_even_of_what_the_error_stream_does_not(world, package):
    shown = logging.StreamHandler(open("/dev/null", "w"))  # noqa: SIM115
    root = logging.getLogger()
    root.handlers[:] = [shown]
    package.setLevel(logging.WARNING)
    tail = keep_log()
    assert keep_log() is tail
    assert shown.level == logging.WARNING
    console = SpectatorConsole(world, tail=tail)
    assert console.run("showlog") == "nothing has been logged yet"
    log = logging.getLogger("usarmjx.server.gamebots.server")
    for number in range(MAX_KEPT_LINES + 5):
        log.info("client %d: connected", number)
    log.error("two\nlines " + "x" * MAX_LOG_LINE)
    lines = console.run("showlog 3").splitlines()
    assert [line.split(" ", 1)[1][:20] for line in lines] == [
        "INFO client 503: con",
        "INFO client 504: con",
        "ERROR two lines xxxx",
    ]
    assert len(lines[2]) == MAX_LOG_LINE
    assert len(console.run("showlog 499").splitlines()) == 499
    assert len(console.run("showlog").splitlines()) == 20
    assert len(tail.lines) == MAX_KEPT_LINES
    shown.stream.close()


def test_editactor_is_that_of_the_world(world):
    console = SpectatorConsole(world)
    assert console.run("editactor name=R1").startswith(f"R1 ({CLASS}): ")
    assert "only in a world of engine c" in console.run("editactor name=R1 msgTimer=1")


def test_who_may_only_look_gets_nothing_else(world):
    controls = Controls()
    console = SpectatorConsole(world, controls, tail=LogTail(), trusted=False)
    for line in ("pause", "showlog", "editactor name=R1", "editactor name=R1 msgTimer=1"):
        assert console.run(line) == f"{line.split()[0]}: {NOT_ALLOWED}"
    assert not controls.paused
    assert "flat at" in console.run("showdebug")
    assert "editactor" in console.run("help")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("killall", "no command 'killall'; known: showlog, showdebug, editactor, pause, help"),
        ("editactor 'name=R1", "No closing quotation"),
        ("showlog some", "'some' is no number of lines"),
        ("showlog 0", "'0' is no number of lines"),
        ("showlog " + "9" * 100, "is no number of lines"),
        ("showlog 3 4", "'3 4' is no number of lines"),
        ("pause now", "pause takes nothing"),
        ("showdebug all", "showdebug takes nothing"),
        ("help " * 200, "a line has at most 500 characters"),
    ],
)
def test_a_wrong_line_is_told_what_is_wrong(world, line, told):
    assert told in SpectatorConsole(world, Controls(), tail=LogTail()).run(line)


def test_an_empty_line_says_nothing_and_help_names_every_command(world):
    console = SpectatorConsole(world)
    assert console.run("  ") == ""
    assert [line.split()[0].strip(":") for line in console.run("help").splitlines()] == console.commands
