"""Settings of the Gamebots server: its address, and the number of clients."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, validate
from usarmjx.models.ini.parse import as_whole, fail, read_ini
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.ports import BOT_PORT, PORT
from usarmjx.server.protocol.dialects import MANUAL, Dialect

SECTIONS = ("BotAPI.BotServer", "USARBotAPI.BotServer")
"""The manual's section of the server, and that of the later versions' DefaultUSAR.ini."""
KEYS = {"listenport": ("port", 0, 65535), "maxconnections": ("max_connections", 1, 4096)}
"""Fields of `BotServerSettings` by key, with smallest and largest value; port 0 picks a free one."""


@dataclass(frozen=True)
class BotServerSettings:
    """Settings of a Gamebots server.

    Attributes:
        host: Address to bind; loopback by default.
        port: TCP port (BotAPI.ini: ListenPort); 0 picks a free one.
        max_connections: Most clients at once (BotAPI.ini: MaxConnections).
        init_timeout: Time after which a silent client without a robot makes room, and one that only sends
            commands when no connection is left; 0: never [s].
        max_faults: Unusable lines in a row after which a client is dropped, of which a refused INIT counts as
            `session.REFUSAL_FAULTS`; 0: never.
        access: Peers that may connect.
        dialect: Vocabulary of the clients.
        time_limit: Minutes of simulated time after which serving ends (manual 5.1: TimeLimit); 0: never.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, PORT] = BOT_PORT
    max_connections: Annotated[int, AT_LEAST_ONE] = 16
    init_timeout: Annotated[float, NOT_NEGATIVE] = 60.0
    max_faults: Annotated[int, NOT_NEGATIVE] = 1000
    access: AccessRules = EVERYBODY
    dialect: Dialect = MANUAL
    time_limit: Annotated[int, NOT_NEGATIVE] = 0

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


def read_bot_server(paths: Iterable[str | Path]) -> dict[str, int]:
    """Return `SECTIONS` of ini files by fields of `BotServerSettings`; later files override.

    Raises:
        SpecError: A file cannot be read, or the section has a wrong key or value; names file and line.
    """
    fields: dict[str, int] = {}
    for path in paths:
        read = read_ini(Path(path))
        # The later versions' section wins over the manual's, wherever the two stand in a file.
        for section, line in ((name, line) for name in SECTIONS for line in read.section(name).lines):
            if line.key.lower() not in KEYS:
                fail(line, f"[{section}] has no key {line.key}", "ListenPort or MaxConnections")
            name, least, most = KEYS[line.key.lower()]
            fields[name] = as_whole(line, least, most)
    return fields
