"""`usarmjx eval` and `usarmjx play`: how good policies are, and what they do."""

import json as json_format
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.files import write_beside
from usarmjx.cli.access_options import (
    AllowHostOption,
    AllowOption,
    PerAddressOption,
    TokenFileOption,
    TokenOption,
    access_rules,
    warn_if_open,
)
from usarmjx.cli.recordings import RecordOption, recorded, recorded_episode
from usarmjx.cli.serve_run import MetricsOption, PageChoice, add_metrics, make_servers, metrics_socket
from usarmjx.cli.tools import ErrorExit, PortOffsetOption, SeedOption
from usarmjx.cli.viewer_options import (
    ShowLiveOption,
    ViewerControlOption,
    ViewerPortOption,
    add_controls,
    add_viewer,
    viewer_settings,
    viewer_socket,
)
from usarmjx.cli.waiting import announce
from usarmjx.server.instances import parse_instances
from usarmjx.server.ports import BOT_PORT, bound_ports, count_up
from usarmjx.server.signals import StopSignals

if TYPE_CHECKING:
    from usarmjx.server.worlds.policy_world import PolicyWorld
    from usarmjx.train.policies.sources import PolicySource

app = typer.Typer()

PolicyArgument = Annotated[
    str | None,
    typer.Argument(help="Folder of a run, a file of `usarmjx export`, or the task of a packaged policy."),
]
BaselineOption = Annotated[
    str | None, typer.Option(help="Instead of a trained policy the one written by hand for a task.")
]
TaskOption = Annotated[
    str | None, typer.Option(help="Name of the task, if it is not the one that the policy is for.")
]
CheckpointOption = Annotated[str, typer.Option(help="Of a run: best, last, or the number of an iteration.")]
EngineOption = Annotated[str, typer.Option(help="warp, jax, c, or auto: the best for this here.")]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="A field of the task as key=value; may be repeated."),
]


def _source(policy: str | None, baseline: str | None, task: str | None, checkpoint: str) -> "PolicySource":
    """Return the policy that a command line names."""
    from dataclasses import replace

    from usarmjx.base.errors import UsageError
    from usarmjx.train.policies.sources import baseline as by_hand
    from usarmjx.train.policies.sources import find_source

    if (policy is None) == (baseline is None):
        raise UsageError("name either a run, file or packaged policy, or a --baseline")
    if baseline is not None:
        return by_hand(baseline, task)
    found = find_source(str(policy), checkpoint)
    same = task is None or task.lower() == found.task.lower()
    # Another task has other fields than those that were set in training.
    return found if same else replace(found, task=str(task), overrides={})


def _echo_notes(notes: list[str]) -> None:
    for note in notes:
        typer.echo(f"usarmjx: note: {note}", err=True)


@app.command("eval")
def evaluate_policy(
    policy: PolicyArgument = None,
    baseline: BaselineOption = None,
    task: TaskOption = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each seed, at least.")] = 100,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds, from --seed on.")] = 1,
    seed: SeedOption = 0,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once, each with as many episodes.")] = 20,
    engine: EngineOption = "auto",
    level: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="How difficult generated arenas are at most.")
    ] = None,
    checkpoint: CheckpointOption = "best",
    settings: SettingsOption = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the result with every episode to this file.")
    ] = None,
) -> None:
    """Tell a policy's mean final score and the 95 % interval of that mean."""
    with ErrorExit():
        announce("building the worlds that the policy is tried in ...")
        from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes

        found = _source(policy, baseline, task, checkpoint)
        many = min(worlds, episodes)
        env, driver, notes = found.env(settings or (), worlds=many, engine=engine, seed=seed)
        _echo_notes(notes)
        result = evaluate_episodes(env, driver, episodes, range(seed, seed + seeds), level)
        score, count = result.score, sum(len(run.scores) for run in result.episodes)
        bad = sum(run.bad for run in result.episodes)
        over = f"{count} episodes" if seeds == 1 else f"{seeds} seeds, {count} episodes"
        interval = f"{score.low:.3f} to {score.high:.3f}" if math.isfinite(score.low) else "unknown"
        typer.echo(
            f"{found.task}, {found.name}: score {score.mean:.3f}, 95 % interval {interval} ({over}"
            f"{f', {bad} left out: physics failed' if bad else ''})"
        )
        if json is not None:
            what = {"task": found.task, "policy": found.name, "checkpoint": checkpoint, "engine": engine}
            setup = {"worlds": many, "level": level, "settings": [*settings] if settings else []}
            with write_beside(json) as fresh:
                fresh.write_text(json_format.dumps({**what, **setup, **as_record(result)}, indent=1) + "\n")


@app.command()
def play(
    policy: PolicyArgument = None,
    baseline: BaselineOption = None,
    task: TaskOption = None,
    out: Annotated[Path, typer.Option(help="Picture to write: .png is a strip, .gif moves.")] = Path(
        "play.png"
    ),
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Simulated time at most; else until the episode ends.")
    ] = None,
    seed: SeedOption = 0,
    engine: EngineOption = "c",
    checkpoint: CheckpointOption = "best",
    settings: SettingsOption = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve the running world to protocol clients instead.")
    ] = False,
    worlds: Annotated[int, typer.Option(min=1, help="With --serve: worlds in the batch.")] = 1,
    instances: Annotated[
        str, typer.Option(help="With --serve: which of them to serve, all or numbers as 0,2-5.")
    ] = "0",
    follow: Annotated[
        bool, typer.Option("--follow", help="With --serve: the newest checkpoint of the run drives, always.")
    ] = False,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0 picks a free one.")] = BOT_PORT,
    port_offset: PortOffsetOption = 0,
    allow: AllowOption = None,
    token: TokenOption = None,
    token_file: TokenFileOption = None,
    connections_per_address: PerAddressOption = None,
    realtime_factor: Annotated[
        float, typer.Option(min=0.0, help="Simulated seconds per second; 0: as fast as it can.")
    ] = 1.0,
    spectator_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="With --serve: show the world on a page of this port, too."),
    ] = None,
    allow_host: AllowHostOption = None,
    metrics_port: MetricsOption = None,
    view: ShowLiveOption = False,
    record: RecordOption = None,
    viewer_port: ViewerPortOption = None,
    viewer_control: ViewerControlOption = False,
) -> None:
    """Show one world of a policy at work: draw an episode from above, show it in a browser, or serve it."""
    with ErrorExit():
        if serve or view:
            # Who only wants to see it needs no port of its own for clients; they may come all the same.
            port = port if serve else 0
            pages = [] if spectator_port is None else [PageChoice(spectator_port, allow_host or ())]
            first = {"--port": port} | {key: n for page in pages for key, n in page.ports.items()}
            numbers = parse_instances(instances, worlds)
            rules = access_rules(allow, token, token_file, connections_per_address)
            with (
                StopSignals() as signals,
                bound_ports(host, count_up(first, len(numbers), port_offset)) as bound,
                metrics_socket(host, metrics_port, port_offset) as metrics,
                viewer_socket(host, viewer_port, port_offset, view or viewer_port is not None) as page,
            ):
                warn_if_open(bound[0]["--port"].getsockname()[0], rules)
                announce("building the world that the policy drives ...")
                source = _source(policy, baseline, task, checkpoint) if not follow else _followed(policy)
                made = _policy_worlds(source, settings, engine, seed, worlds, numbers)
                from usarmjx.server.bot_server import BotServerSettings
                from usarmjx.server.clock import StepClock
                from usarmjx.server.loop import serve as run

                makers = [page.prepare(host, rules) for page in pages]
                settings_of = BotServerSettings(host, access=rules)
                servers = make_servers(made, settings_of, makers, bound, numbers, worlds)
                if follow:
                    from usarmjx.server.worlds.follow import PolicyFollower

                    servers[0].services.append(PolicyFollower(made[0].policy_batch, Path(policy or "")))
                if metrics is not None:
                    add_metrics(servers, realtime_factor, metrics, numbers)
                clock = StepClock(realtime_factor)
                controls = add_controls(servers, clock)
                if page is not None:
                    add_viewer(
                        servers,
                        controls,
                        page,
                        viewer_settings(host, rules, allow_host or (), viewer_control),
                    )
                with recorded(made, record):
                    run(servers, clock, signals)
            return
        # What one world observes in one episode takes longer to compile than to compute.
        announce("building the world that the policy drives ...", quickly=engine == "c")
        from usarmjx.plots.play import check_suffix, record_episode, save_recording

        check_suffix(out)
        env, driver, notes = _source(policy, baseline, task, checkpoint).env(
            settings or (), engine=engine, seed=seed
        )
        _echo_notes(notes)
        with recorded_episode(env, record, seed) as watch:
            shown = record_episode(env, driver, math.inf if seconds is None else seconds, seed, watch)
        save_recording(shown, out)
        last = f"{shown.times[-1]:.1f} s, score {shown.scores[-1]:.2f}"
        typer.echo(f"{shown.task}: {last}{f', {shown.end}' if shown.end else ''}: {out}")


def _followed(run: str | None) -> "PolicySource":
    """Return the policy of a run that may not have begun yet, as soon as it has a checkpoint."""
    from usarmjx.base.errors import UsageError
    from usarmjx.server.worlds.follow import wait_for_run

    if run is None:
        raise UsageError("--follow needs the folder of a run")
    return wait_for_run(Path(run))


def _policy_worlds(
    source: "PolicySource",
    settings: list[str] | None,
    engine: str,
    seed: int,
    worlds: int,
    instances: Sequence[int],
) -> "list[PolicyWorld]":
    """Return worlds of a batch that a policy drives, and tell which robots clients may take over."""
    from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld

    env, driver, notes = source.env(settings or (), worlds=worlds, engine=engine, seed=seed)
    _echo_notes(notes)
    shared = PolicyBatch(env, driver, seed=seed)
    made = [PolicyWorld(shared, instance) for instance in instances]
    typer.echo(f"robots to take over by INIT: {', '.join(made[0].agents())}")
    return made
