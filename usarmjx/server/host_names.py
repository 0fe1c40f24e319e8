"""The names under which a browser may ask for our pages.

A site elsewhere can let a name of its own lead to this machine (DNS rebinding): then a browser takes our
pages for those of that site, and only the name in the request tells.
"""

import re
from collections.abc import Collection
from http import HTTPStatus

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from usarmjx.base.errors import UsageError
from usarmjx.server.access import parse_address
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.web_gate import RequestAnswer

_HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::[0-9]+)?", re.IGNORECASE)
_NAME = re.compile(r"[a-z0-9._-]+|[0-9a-f:.]+", re.IGNORECASE)
LOCALHOST = re.compile(r"(?:.+\.)?localhost")
"""These names are no site's: they always mean the browser's own machine."""


def check_names(names: Collection[str], option: str = "--allow-host") -> tuple[str, ...]:
    """Return the names of an option as they are compared.

    Raises:
        UsageError: One is no host name and no IP address.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            wanted = "expected a name or IP address alone, as sim.example.org"
            raise UsageError(f"{option}: {name!r} is no host; {wanted}")
    return tuple(map(_plain, names))


def is_own_name(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header names this server.

    Args:
        host: The header, with or without a port.
        names: What it is called beside `LOCALHOST`: names and IP addresses, as from `check_names`.
    """
    found = _HOST.fullmatch(host)
    name = _plain(found[1] or found[2]) if found else ""
    return name in names or LOCALHOST.fullmatch(name) is not None


def for_own_names(names: Collection[str], answer: RequestAnswer) -> RequestAnswer:
    """Return what refuses requests under names that are not ours, and leaves the others to another one.

    Args:
        names: What the server is called beside `LOCALHOST` and the IP address that a connection came to.
        answer: Answers the others.
    """
    names = {_plain(name) for name in names}

    def answer_own(connection: ServerConnection, request: Request) -> Response | None:
        hosts, here = request.headers.get_all("Host"), connection.local_address
        own = {*names, _plain(str(here[0]))} if here else set(names)
        if len(hosts) == 1 and is_own_name(hosts[0], own):
            return answer(connection, request)
        told = f"not served under the name {clip(', '.join(hosts))}; --allow-host NAME allows one\n"
        return connection.respond(HTTPStatus.FORBIDDEN, told)

    return answer_own


def _plain(name: str) -> str:
    """Return a name or IP address in the one way in which it is compared."""
    try:
        return str(parse_address(name))
    except ValueError:
        return name.lower().removesuffix(".")
