"""Who may connect: networks that are let in, a token, and how many connections an address may have."""

import hashlib
import hmac
import ipaddress
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.protocol.grammar import clip, parse_message

IPAddress: TypeAlias = ipaddress.IPv4Address | ipaddress.IPv6Address
IPNetwork: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

AUTH = "AUTH"
"""What the first line begins with where a token is asked for."""
MAX_TOKEN_SIZE = 128
"""Longest token [bytes]."""
_TOKEN = re.compile(rf"[A-Za-z0-9._~+/=-]{{1,{MAX_TOKEN_SIZE}}}")


@dataclass(frozen=True)
class AccessRules:
    """Who may connect to the ports of a server.

    Attributes:
        allow: Networks that connections are accepted from; none: from anywhere.
        token: What clients have to say first; nothing: they need not.
        per_address: Most connections of one address to one kind of port, unless it is loopback; None: three
            quarters of what such a port holds.
    """

    allow: tuple[IPNetwork, ...] = ()
    token: str = field(default="", repr=False)
    per_address: int | None = None

    def allows(self, address: IPAddress) -> bool:
        """Return whether an address is let in."""
        return not self.allow or any(address in network for network in self.allow)

    def knows(self, token: str) -> bool:
        """Return whether a token is the right one; how long that takes does not tell how much of it is."""
        return bool(self.token) and hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode())

    @cached_property
    def cookie(self) -> str:
        """What a browser is given for the token: not the token, as it goes to every port of that host."""
        return hmac.new(self.token.encode(), b"usarmjx page", hashlib.sha256).hexdigest()

    def knows_cookie(self, cookie: str) -> bool:
        """Return whether a cookie is the right one."""
        return hmac.compare_digest(cookie.encode("utf-8", "replace"), self.cookie.encode())


EVERYBODY = AccessRules()
"""The rules unless the operator says otherwise."""


def parse_address(text: str) -> IPAddress:
    """Return an IP address; an IPv4 one that is written as IPv6 is IPv4.

    Raises:
        ValueError: It is none.
    """
    address = ipaddress.ip_address(text.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def parse_networks(texts: Iterable[str]) -> tuple[IPNetwork, ...]:
    """Return the networks of lists as `10.0.0.0/8,2001:db8::1`; a single address is a network of one.

    Raises:
        UsageError: One is none.
    """
    networks: list[IPNetwork] = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            networks.append(ipaddress.ip_network(part, strict=False))
        except ValueError as error:
            raise UsageError(
                f"--allow: {part!r} is no network; expected addresses or networks as 10.0.0.0/8,2001:db8::1"
            ) from error
    return tuple(networks)


def check_token(text: str, source: str) -> str:
    """Return a token.

    Args:
        text: The token.
        source: Where it is from, for the message, which does not repeat it.

    Raises:
        UsageError: It has characters that cannot stand in a line or a cookie, or too many or none.
    """
    if not _TOKEN.fullmatch(text):
        raise UsageError(f"{source}: a token has 1 to {MAX_TOKEN_SIZE} letters, digits and ._~+/=-")
    return text


def read_token(path: Path) -> str:
    """Return the token that a file holds, without white space around it.

    Raises:
        UsageError: The file cannot be read or holds none.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--token-file: cannot read {path}: {error}") from error
    return check_token(text.strip(), f"--token-file {path}")


def token_of(line: str) -> str:
    """Return the token of a line `AUTH {Token T}` or a message `AUTH T`; nothing if it is neither.

    Raises:
        PeerError: It is no AUTH at all.
    """
    head = re.match(r"\s*([^\s{}]*)", line)
    if head is None or head[1].upper() != AUTH:
        raise PeerError(f"it begins with {clip(line, 20)}, not with {AUTH}")
    words = line.split()
    try:
        return words[1] if len(words) == 2 and "{" not in line else parse_message(line).get("Token")
    except PeerError:  # its text could have the token in it
        return ""
