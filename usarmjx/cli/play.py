"""`usarmjx play`: what a policy does, as a picture, in a browser, or served."""

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, WorldsOption, announce, ends_on_signals, unwinds_on_signals
from usarmjx.cli.recordings import recorded_episode
from usarmjx.cli.serving_options import (
    Host,
    ImageOptions,
    ListenOptions,
    RadioOptions,
    Ros2Options,
    RosOptions,
    RunOptions,
    ViewerOptions,
)
from usarmjx.cli.setting_options import with_settings
from usarmjx.cli.task_options import PolicyEngineOption, PolicyOptions
from usarmjx.cli.viewer_options import ViewOption
from usarmjx.server.runtime.signals import StopSignals
from usarmjx.server.worlds.instances import parse_instances

if TYPE_CHECKING:
    from usarmjx.server.gamebots.server import Service
    from usarmjx.server.worlds.policy_world import PolicyWorld
    from usarmjx.train.policies.sources import PolicySource


@dataclass(frozen=True, kw_only=True)
class ServedOptions:
    """Worlds of a policy that are served, and their drivers; each field is an option."""

    panel: ClassVar[str] = "With --serve or --view"

    worlds: WorldsOption = 1
    instances: Annotated[str, typer.Option(help="Which of them to serve, all or numbers as 0,2-5.")] = "0"
    follow: Annotated[
        bool, typer.Option("--follow", help="The newest checkpoint of the run drives, always.")
    ] = False


@with_settings
def play(
    driver: PolicyOptions,
    served: ServedOptions,
    listen: ListenOptions,
    run: RunOptions,
    radio: RadioOptions,
    images: ImageOptions,
    ros: RosOptions,
    ros2: Ros2Options,
    viewer: ViewerOptions,
    engine: PolicyEngineOption = "c",
    out: Annotated[Path, typer.Option(help="Picture to write: .png is a strip, .gif moves.")] = Path(
        "play.png"
    ),
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Simulated time at most; else until the episode ends.")
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve the running world to protocol clients instead.")
    ] = False,
    view: ViewOption = False,
) -> None:
    """Show a policy at work in one world: draw an episode, show it in a browser, or serve it."""
    with ErrorExit():
        # A run that is followed may not have begun: its folder need not be there yet.
        if not served.follow:
            driver.check()
        if driver.print_config:
            driver.print_fields()
            return
        if not (serve or view):
            with drawing_signals(run.record):
                _draw_episode(driver, engine, out, seconds, run.record)
            return
        # A picture in a browser needs no ports of its own for clients; they may come all the same.
        listen = listen if serve else replace(listen, port=0)
        host = Host(
            listen=listen,
            settings=listen.settings((), None),
            numbers=parse_instances(served.instances, served.worlds),
            run=run,
            viewer=viewer,
            view=view or viewer.viewer_port is not None,
            # Without clients of the protocol nobody hears the radio or asks for pictures.
            services=(radio, images, ros, ros2) if serve else (ros, ros2),
        )
        with StopSignals() as signals, host.ports() as ports:
            host.warn(ports)
            # Clients that come while the world is built, or before a run's first checkpoint, wait here.
            for sockets in ports.bound:
                sockets["--port"].listen()
            announce("building the world that the policy drives ...")
            services = host.prepare()
            worlds, more = _policy_worlds(driver, served, engine, host.numbers)
            heard = radio.constants if serve and radio.wanted else None
            host.serve(worlds, ports, services, signals, batch_size=served.worlds, more=more, radio=heard)


def drawing_signals(record: Path | None) -> AbstractContextManager[object]:
    """While an episode is drawn, end at once on a signal; a recording is closed before, if there is one."""
    return ends_on_signals() if record is None else unwinds_on_signals(kept=f": {record} ends there")


def _draw_episode(
    driver: PolicyOptions, engine: str, out: Path, seconds: float | None, record: Path | None
) -> None:
    """Draw an episode, and record it if that is wanted."""
    # Observations of one world in one episode take longer to compile than to compute.
    announce("building the world that the policy drives ...", quickly=engine == "c", engines=[engine])
    from usarmjx.plots.play import check_suffix, record_episode, save_recording

    # Before the worlds are built, which takes much longer than this look at the name.
    check_suffix(out)
    env, policy = driver.env(driver.source(), 1, engine)
    with recorded_episode(env, record, driver.seed) as watch:
        shown = record_episode(env, policy, math.inf if seconds is None else seconds, driver.seed, watch)
    save_recording(shown, out)
    last = f"{shown.times[-1]:.1f} s, score {shown.scores[-1]:.2f}"
    typer.echo(f"{shown.task}: {last}{f', {shown.end}' if shown.end else ''}: {out}")


def _policy_worlds(
    driver: PolicyOptions, served: ServedOptions, engine: str, instances: Sequence[int]
) -> "tuple[list[PolicyWorld], list[Service]]":
    """Return worlds of a batch that a policy drives, and what follows its training, if anything does.

    Tells which robots clients may take over.
    """
    from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld

    source = _followed(driver.policy, driver.task) if served.follow else driver.source()
    env, policy = driver.env(source, served.worlds, engine)
    # All worlds of the batch step at once: one policy call serves them all.
    shared = PolicyBatch(env, policy, seed=driver.seed)
    made = [PolicyWorld(shared, instance) for instance in instances]
    typer.echo(f"robots to take over by INIT: {', '.join(made[0].agents())}")
    if not served.follow:
        return made, []
    from usarmjx.server.worlds.policy_world import PolicyFollower

    return made, [PolicyFollower(shared, Path(driver.policy or ""))]


def _followed(run: str | None, task: str | None) -> "PolicySource":
    """Return the policy of a run that may not have begun yet, as soon as it has a checkpoint."""
    from usarmjx.server.worlds.policy_world import wait_for_run

    if run is None:
        raise UsageError("--follow needs the folder of a run")
    found = wait_for_run(Path(run))
    return found if task is None else found.for_task(task)
