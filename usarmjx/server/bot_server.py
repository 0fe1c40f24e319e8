"""How the Gamebots server is set up: where it listens, and how many may come (manual 9.1)."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from usarmjx.models.ini.parse import read_ini
from usarmjx.models.ini.read import as_whole, fail
from usarmjx.server.access import EVERYBODY, AccessRules
from usarmjx.server.ports import BOT_PORT
from usarmjx.server.protocol.dialects import MANUAL, Dialect

SECTION = "BotAPI.BotServer"
KEYS = {"listenport": ("port", 0, 65535), "maxconnections": ("max_connections", 1, 4096)}
"""What each key sets of `BotServerSettings`, its least and its largest value; port 0 picks a free one."""


@dataclass(frozen=True)
class BotServerSettings:
    """How to serve.

    Attributes:
        host: Address to bind; loopback by default.
        port: TCP port (BotAPI.ini: ListenPort); 0 picks a free one.
        max_connections: Most clients at once (BotAPI.ini: MaxConnections).
        init_timeout: Who has no robot and asks for nothing for so long makes room, and who only asks
            does when no seat is left; 0: nobody has to [s].
        max_faults: A client is dropped after so many lines in a row that could not be used, of which a
            refused INIT counts as `session.REFUSAL_FAULTS`; 0: never.
        access: Who may connect.
        dialect: In which version's words clients speak.
        time_limit: Minutes of simulated time after which serving ends (manual 5.1: TimeLimit); 0: never.
    """

    host: str = "127.0.0.1"
    port: int = BOT_PORT
    max_connections: int = 16
    init_timeout: float = 60.0
    max_faults: int = 1000
    access: AccessRules = EVERYBODY
    dialect: Dialect = MANUAL
    time_limit: int = 0


@dataclass
class Tally:
    """What a server has counted since it began.

    Attributes:
        connections: Clients that were accepted.
        commands: Legal commands by their types.
        faults: What was wrong with the lines of clients that have left.
    """

    connections: int = 0
    commands: Counter[type] = field(default_factory=Counter[type])
    faults: int = 0


def read_bot_server(paths: Iterable[str | Path]) -> dict[str, int]:
    """Return `[BotAPI.BotServer]` of ini files by fields of `BotServerSettings`; later files override.

    Raises:
        SpecError: A file cannot be read, or the section has a wrong key or value; names file and line.
    """
    fields: dict[str, int] = {}
    for path in paths:
        for line in read_ini(Path(path)).section(SECTION).lines:
            if line.key.lower() not in KEYS:
                fail(line, f"[{SECTION}] has no key {line.key}", "ListenPort or MaxConnections")
            name, least, most = KEYS[line.key.lower()]
            fields[name] = as_whole(line, least, most)
    return fields
