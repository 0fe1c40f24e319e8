"""Access rules: networks that may connect, a token, and connections per address."""

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
from usarmjx.server.protocol.grammar import AUTH, clip, parse_message

IPAddress: TypeAlias = ipaddress.IPv4Address | ipaddress.IPv6Address
IPNetwork: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

MAX_TOKEN_SIZE = 128
"""Longest token [bytes]."""
_TOKEN = re.compile(rf"[A-Za-z0-9._~+/=-]{{1,{MAX_TOKEN_SIZE}}}")


@dataclass(frozen=True)
class AccessRules:
    """Rules for connections to the ports of a server.

    Attributes:
        allow: Networks that connections are accepted from; none: from anywhere.
        token: Token that clients send first; empty: none is required.
        per_address: Most connections of one address to one kind of port, unless it is loopback; None: three
            quarters of the port's capacity.
    """

    allow: tuple[IPNetwork, ...] = ()
    token: str = field(default="", repr=False)
    per_address: int | None = None

    def allows(self, address: IPAddress) -> bool:
        """Return whether an address may connect."""
        return not self.allow or any(address in network for network in self.allow)

    def knows(self, token: str) -> bool:
        """Return whether a token is the right one, in a time that does not depend on the match."""
        # Without a token the empty text would be equal to it.
        return bool(self.token) and hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode())

    @cached_property
    def cookie(self) -> str:
        """Cookie for the token: a hash of it, as browsers send cookies to every port of a host."""
        # The text keeps this hash apart from any other use of the token.
        return hmac.new(self.token.encode(), b"usarmjx page", hashlib.sha256).hexdigest()

    def knows_cookie(self, cookie: str) -> bool:
        """Return whether a cookie is the right one."""
        return hmac.compare_digest(cookie.encode("utf-8", "replace"), self.cookie.encode())


EVERYBODY = AccessRules()
"""The default rules."""


def parse_address(text: str) -> IPAddress:
    """Return an IP address; an IPv4 address that is mapped to IPv6 is IPv4.

    Raises:
        ValueError: The text is no address.
    """
    # A link-local peer comes as fe80::1%eth0; no network of a rule has a zone.
    address = ipaddress.ip_address(text.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def parse_networks(texts: Iterable[str]) -> tuple[IPNetwork, ...]:
    """Return the networks of lists such as `10.0.0.0/8,2001:db8::1`; a single address is a network of one.

    Raises:
        UsageError: A part is no network.
    """
    networks: list[IPNetwork] = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            # Not strict: 10.0.0.7/8 means the network around that address.
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
        source: Origin of the token, for the message, which does not repeat the token.

    Raises:
        UsageError: It is empty, too long, or has characters that cannot stand in a line or a cookie.
    """
    if not _TOKEN.fullmatch(text):
        raise UsageError(f"{source}: a token has 1 to {MAX_TOKEN_SIZE} letters, digits and ._~+/=-")
    return text


def read_token(path: Path) -> str:
    """Return the token in a file, without white space around it.

    Raises:
        UsageError: The file cannot be read or has no token.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--token-file: cannot read {path}: {error}") from error
    return check_token(text.strip(), f"--token-file {path}")


def token_of(line: str) -> str:
    """Return the token of a line `AUTH {Token T}` or a message `AUTH T`; empty if it is neither.

    Raises:
        PeerError: It is no AUTH at all.
    """
    head = re.match(r"\s*([^\s{}]*)", line)
    if head is None or head[1].upper() != AUTH:
        raise PeerError(f"it begins with {clip(line, 20)}, not with {AUTH}")
    words = line.split()
    try:
        return words[1] if len(words) == 2 and "{" not in line else parse_message(line).get("Token")
    except PeerError:  # not passed on: its text could contain the token, which must not get into a log
        return ""
