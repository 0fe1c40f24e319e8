"""`usarmjx chaos`: attacks on a server of one's own, and what a well-behaved neighbour notices."""

import contextlib
import json as json_format
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, SeedOption, named, unwinds_on_signals
from usarmjx.cli.known_names import complete_arenas
from usarmjx.cli.setting_options import with_settings
from usarmjx.server.network.ports import LAST_PORT
from usarmjx.server.runtime.signals import FILES_TIME

if TYPE_CHECKING:
    from benchmarks.chaos.target import Target

MEGABYTE = 1e6


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """Which server is attacked; each field is an option."""

    panel: ClassVar[str] = "Server"

    address: Annotated[str | None, typer.Argument(help="HOST:PORT of the server; or --self.")] = None
    own: Annotated[bool, typer.Option("--self", help="Start a server for it, and attack that.")] = False
    arena: Annotated[
        str,
        typer.Option(
            help="With --self: arena name, or a file.",
            autocompletion=complete_arenas,
            callback=named("arena"),
        ),
    ] = "yellow"
    viewer_port: Annotated[
        int | None, typer.Option(min=1, max=LAST_PORT, help="Port of its live page; else that is spared.")
    ] = None
    metrics_port: Annotated[
        int | None, typer.Option(min=1, max=LAST_PORT, help="Port of its metrics, which a soak needs.")
    ] = None
    rosbridge_port: Annotated[
        int | None, typer.Option(min=1, max=LAST_PORT, help="Port of its rosbridge; else that is spared.")
    ] = None
    image_port: Annotated[
        int | None, typer.Option(min=1, max=LAST_PORT, help="Port of its pictures; else that is spared.")
    ] = None
    pid: Annotated[
        int | None, typer.Option(min=1, help="Its process; else the listener there, if that is yours.")
    ] = None
    own_server: Annotated[
        bool,
        typer.Option(
            "--own-server",
            help="The address is not loopback, but the server is yours, and so is the network.",
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class AttackOptions:
    """Attacks on it; each field is an option."""

    panel: ClassVar[str] = "Attacks"

    attack: Annotated[list[str] | None, typer.Option(help="Only this attack; may be repeated. Else all.")] = (
        None
    )
    attackers: Annotated[int, typer.Option(min=1, max=200, help="Attackers at once.")] = 15
    seconds: Annotated[float, typer.Option(min=0.1, max=600.0, help="Length of each attack.")] = 8.0
    volume: Annotated[
        float, typer.Option(min=0.001, max=100.0, help="Most that one attacker sends in an attack, in MB.")
    ] = 4.0


@dataclass(frozen=True, kw_only=True)
class SoakOptions:
    """Robots for hours in place of attacks; each field is an option."""

    panel: ClassVar[str] = "Hours"

    soak: Annotated[
        float | None,
        typer.Option(min=1.0, help="Drive robots at random for this time instead, and watch its memory [s]."),
    ] = None
    clients: Annotated[int, typer.Option(min=1, max=64, help="With --soak: number of robots.")] = 12
    every: Annotated[float, typer.Option(min=0.1, help="With --soak: seconds between two samples.")] = 30.0
    onlookers: Annotated[
        int, typer.Option(min=0, max=12, help="With --soak: websocket clients at the page and at rosbridge.")
    ] = 0
    records: Annotated[bool, typer.Option("--record", help="With --self: the server records its world.")] = (
        False
    )


@with_settings
def chaos(
    server: TargetOptions,
    what: AttackOptions,
    hours: SoakOptions,
    seed: SeedOption = 0,
    json: Annotated[
        Path | None, typer.Option(help="Append a line for each attack or sample to this file.")
    ] = None,
) -> None:
    """Attack a server of your own, within bounds, and report the effect on a well-behaved neighbour.

    Its columns: the neighbour's longest wait for a report, the most processor time that the server's main
    thread used between two of its reports, reports at a wrong time of the world, lines that are none; the
    amount sent, the numbers of attackers that came and were hung up on, and whether all seats are free again.
    """
    with ErrorExit():
        from benchmarks.chaos.attacks import find_attack

        for name in what.attack or ():
            find_attack(name)
    # A server that is started for it takes as long to end.
    with ErrorExit(), unwinds_on_signals(patience=FILES_TIME), _target(server, hours.records) as target:
        say = partial(typer.echo, err=True)
        if hours.soak is None:
            _attack(target, what, json, say)
            return
        from benchmarks.chaos.soak import SoakCase
        from benchmarks.chaos.soak import soak as run

        case = SoakCase(
            target=target,
            seconds=hours.soak,
            clients=hours.clients,
            every=hours.every,
            seed=seed,
            onlookers=hours.onlookers,
        )
        typer.echo(json_format.dumps(run(case, json, say), indent=1))


def _attack(target: "Target", what: AttackOptions, json: Path | None, say: Callable[[str], None]) -> None:
    """Play attacks one after the other, and tell what came of them."""
    from benchmarks.chaos.attacks import ATTACKS, find_attack
    from benchmarks.chaos.play import ChaosCase, play_attacks, table
    from benchmarks.chaos.target import main_thread_clock
    from benchmarks.tools import append_record, record_header

    chosen = [find_attack(name) for name in what.attack] if what.attack else ATTACKS
    case = ChaosCase(
        host=target.host,
        port=target.port,
        page_port=target.page_port,
        rosbridge_port=target.rosbridge_port,
        metrics_port=target.metrics_port,
        image_port=target.image_port,
        attacks=tuple(chosen),
        attackers=what.attackers,
        seconds=what.seconds,
        volume=round(what.volume * MEGABYTE),
    )
    clock = None if target.process is None else main_thread_clock(target.process, say)
    outcomes = play_attacks(case, clock, say)
    typer.echo(table(outcomes))
    header = record_header("chaos", host=True) if json is not None else {}
    header["case"] = {"attackers": case.attackers, "seconds": case.seconds, "volume": case.volume}
    for outcome in outcomes:
        append_record(header | outcome.as_record(), json)


@contextlib.contextmanager
def _target(options: TargetOptions, records: bool = False) -> "Iterator[Target]":
    """Yield whom the options name."""
    from benchmarks.chaos.target import (
        Target,
        check_listening,
        check_loopback,
        local_process,
        parse_host_port,
        started,
    )

    if options.own == (options.address is not None):
        raise UsageError("name either HOST:PORT of a server that runs, or --self")
    if options.address is None:
        with started(options.arena, 16, records=records) as target:
            yield target
        return
    host, port = parse_host_port(options.address)
    if not options.own_server:
        check_loopback(host)
    check_listening(host, port)
    process = options.pid or (None if options.own_server else local_process(port))
    yield Target(
        host,
        port,
        options.viewer_port,
        options.metrics_port,
        process,
        options.rosbridge_port,
        options.image_port,
    )
