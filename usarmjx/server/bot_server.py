"""BotAPI.ini: where the Gamebots server listens, and how many may come (manual 9.1)."""

from collections.abc import Iterable
from pathlib import Path

from usarmjx.models.ini.parse import read_ini
from usarmjx.models.ini.read import as_whole, fail

SECTION = "BotAPI.BotServer"
KEYS = {"listenport": ("port", 0, 65535), "maxconnections": ("max_connections", 1, 4096)}
"""What each key sets of `net.BotServerSettings`, its least and its largest value; port 0 picks a free one."""


def read_bot_server(paths: Iterable[str | Path]) -> dict[str, int]:
    """Return `[BotAPI.BotServer]` of ini files by fields of `net.BotServerSettings`; later files override.

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
