"""`usarmjx demo`: robots to look at and to drive; or the main job, checked."""

import logging
import os
import sys
import threading
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, announce
from usarmjx.cli.serving_options import (
    Host,
    ListenOptions,
    RosbridgePortOption,
    RosOptions,
    RunOptions,
    ViewerOptions,
    port_of,
)
from usarmjx.cli.viewer_options import ViewerPortOption
from usarmjx.server.network.ports import BOT_PORT, LAST_PORT, bound_socket
from usarmjx.server.runtime.signals import StopSignals

if TYPE_CHECKING:
    from usarmjx.models.types.arena import ArenaSpec
    from usarmjx.server.worlds.policy_world import PolicyWorld


TASK, ARENA = "explore-v1", "yellow"
STARTS = ("Start26", "Start43", "Start39", "Start14")
"""Start poses of the team, in different parts of the arena."""
EPISODE_STEPS = 600
"""Actions of 0.2 s after which the team forgets its maps and explores anew."""
CUTOFF = -70.0
"""Signals weaker than this are not heard [dBm]; with the task's own cutoff links hold for 3 m at most."""
LAYERS = ("Radio links",)
"""Layers that the page shows beside the default ones."""
SAY_EVERY = 5.0
"""Interval of the line about a running compilation [s]."""
TITLE = "usarmjx demo"


class DemoGuide:
    """A `gamebots.server.Service`: tells how to begin once the robots move, and opens the page in a browser.

    Args:
        page: Address of the page.
        port: Port of clients.
        robots: Names of the robots.
        browser: Whether a browser is to be opened.
    """

    def __init__(self, page: str, port: int, robots: Sequence[str], browser: bool) -> None:
        self._page, self._port, self._robots, self._browser = page, port, robots, browser
        self._told = False

    async def start(self) -> list[str]:
        """Begin; there is nothing to report before robots move."""
        return []

    def tick(self) -> None:
        """The world has made a control step: the robots move."""
        # Once, as every control step comes here.
        if self._told:
            return
        self._told = True
        typer.echo(guide_text(self._page, self._port, self._robots))
        if self._browser:
            # It may take as long as it likes to start.
            threading.Thread(target=open_page, args=(self._page,), name="browser", daemon=True).start()

    def stop(self) -> None:
        """End."""


def guide_text(page: str, port: int, robots: Sequence[str]) -> str:
    """Return a guide to the page, and further commands to try."""
    last = robots[-1]
    return f"""
{len(robots)} robots explore {ARENA}, driven by the baseline of the task `{TASK}`: {page}

  Take one over: press "Take the controls", choose {last} under Robot, press "Take over",
  click beside the arrows, and hold W A S D or the arrow keys; "Give it back" lets the policy go on.
  Click a robot to look through its camera; "Show" switches scans, radio links and the team's map.

Further commands, in another terminal:
  usarmjx console {port}     a client here: INIT {{ClassName USARBot.P2AT}} {{Name {last}}} takes {last}
  usarmjx serve            an arena that waits for a controller of your own
  usarmjx train drive-to-goal --out runs/goal --view
  usarmjx list             robots, sensors, arenas, tasks, policies, engines

Ctrl-C ends the demonstration.
"""


def has_display(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Return whether a browser can show something here: on Linux only where there is a display."""
    if not platform.startswith(("linux", "freebsd")):
        return True
    # Python's web browser module would start a browser of the terminal, as lynx, over the output here.
    return any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def open_page(address: str) -> None:
    """Open a page in the user's browser; its address is printed already if none can be opened."""
    try:
        webbrowser.open(address)
    except (webbrowser.Error, OSError) as error:
        logging.getLogger(__name__).info("no browser: %s", error)


def run_live(browser: bool, port: int | None, viewer_port: int | None, rosbridge_port: int | None) -> None:
    """Serve the demonstration until a signal comes.

    Args:
        browser: Whether to open a browser, where there is a display.
        port: Port of clients; None: the usual port, or a free one where that is taken.
        viewer_port: Port of the page; None: likewise.
        rosbridge_port: Port of ROS clients; None: none.

    Raises:
        UsageError: A port is taken.
    """
    listen = ListenOptions(port=_free(BOT_PORT) if port is None else port)
    host = Host(
        listen=listen,
        settings=listen.settings((), None),
        numbers=(0,),
        run=RunOptions(),
        viewer=ViewerOptions(viewer_port=viewer_port),
        view=True,
        services=(RosOptions(rosbridge_port=rosbridge_port),),
        layers=LAYERS,
    )
    with StopSignals() as signals, host.ports() as ports:
        announce(
            "building four robots in a maze; half a minute the first time ...",
            quickly=True,
            interval=SAY_EVERY,
        )
        services = host.prepare()
        world = make_world()
        assert ports.page is not None
        page = f"http://{listen.host}:{port_of(ports.page)}/"
        guide = DemoGuide(
            page, port_of(ports.bound[0]["--port"]), [*world.agents()], browser and has_display()
        )
        host.serve([world], ports, services, signals, batch_size=1, more=[guide])


def make_world() -> "PolicyWorld":
    """Return the world in which the baseline of the task explores."""
    from usarmjx.models.arenas import ARENAS
    from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld
    from usarmjx.train.baselines import BASELINES
    from usarmjx.train.envs.env import Env
    from usarmjx.train.make import make_task
    from usarmjx.train.tasks.team import WALLED_RADIO

    arena = starting_at(ARENAS.get(ARENA), STARTS)
    radio = replace(WALLED_RADIO, cutoff=CUTOFF)
    task = make_task(TASK, arena=arena, episode_steps=EPISODE_STEPS, radio=radio)
    env = Env(task, 1, name=TASK, engine="c")  # `make` would trace the sizes of observations as well
    return PolicyWorld(PolicyBatch(env, BASELINES.get(TASK)(env)))


def starting_at(arena: "ArenaSpec", tags: tuple[str, ...]) -> "ArenaSpec":
    """Return an arena whose first start poses are those of some tags."""
    starts = {start.tag: start for start in arena.starts}
    rest = [start for start in arena.starts if start.tag not in tags]
    # A robot starts at the pose of its slot's number.
    return replace(arena, starts=(*(starts[tag] for tag in tags), *rest))


def _free(port: int) -> int:
    """Return a port if it is free, else 0: any."""
    try:
        with bound_socket("127.0.0.1", port):
            return port
    except UsageError:
        return 0


JOB = "With --headless"
FOLDER = Path("out")
"""Folder of the headless demonstration's output."""
SECONDS = 20.0
"""Length of its drive [s]."""


def demo(
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser, where one can.")
    ] = True,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=LAST_PORT, help="TCP port for clients; else 3000, or a free one."),
    ] = None,
    viewer_port: ViewerPortOption = None,
    rosbridge_port: RosbridgePortOption = None,
    headless: Annotated[
        bool,
        typer.Option(
            "--headless",
            help="Serve a batch, let a client drive a P2AT over TCP, draw its path and judge it.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the picture and the log; else out.", rich_help_panel=JOB)
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help="Simulated seconds; else 20.", rich_help_panel=JOB)
    ] = None,
) -> None:
    """Show four robots that explore an arena, in a browser; take one over if you like.

    With --headless or --out the main job runs instead, once, and ends: exit code 0,
    or 1 if the robot touched something or hardly moved.
    """
    with ErrorExit():
        if not (headless or out):
            if seconds is not None:
                raise UsageError("--seconds is for --headless; Ctrl-C ends the live demonstration")
            run_live(browser, port, viewer_port, rosbridge_port)
            return
        if any(one is not None for one in (port, viewer_port, rosbridge_port)):
            raise UsageError("ports are for the live demonstration, without --headless")
        announce("starting a server, and a robot to drive in it ...")
        from usarmjx.cli.demo_run import run_demo

        sys.exit(run_demo(out or FOLDER, seconds or SECONDS))
