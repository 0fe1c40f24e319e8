"""The options of commands that serve which say who may connect, and the warning where anybody may."""

import ipaddress
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.server.access import AccessRules, check_token, parse_networks, read_token

TOKEN_VARIABLE = "USARMJX_TOKEN"

AllowHostOption = Annotated[
    list[str] | None,
    typer.Option(help="Name under which browsers may ask for the page, beside localhost; may be repeated."),
]
AllowOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CIDR,...",
        help="Networks or addresses that may connect, to all ports; may be repeated; else all may.",
    ),
]
TokenOption = Annotated[
    str | None,
    typer.Option(
        envvar=TOKEN_VARIABLE,
        help="A secret that clients have to say first, as AUTH {Token ...}. Other users can see it in the "
        "list of processes: better a file or the variable.",
    ),
]
TokenFileOption = Annotated[Path | None, typer.Option(help="A file that holds the token.")]
PerAddressOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Most connections of one address to one kind of port, loopback apart; else three quarters of "
        "what the port holds.",
    ),
]


def access_rules(
    allow: Sequence[str] | None, token: str | None, token_file: Path | None, per_address: int | None
) -> AccessRules:
    """Return the rules that the options make.

    Raises:
        UsageError: One is wrong, or the token is given twice.
    """
    if token is not None and token_file is not None:
        raise UsageError(f"give either --token (or {TOKEN_VARIABLE}) or --token-file")
    if token_file is not None:
        token = read_token(token_file)
    elif token is not None:
        token = check_token(token, f"--token or {TOKEN_VARIABLE}")
    return AccessRules(parse_networks(allow or ()), token or "", per_address)


def warn_if_open(address: str, rules: AccessRules) -> None:
    """Say on the standard error stream what strangers can do, or see, at an address that they can reach.

    Args:
        address: IP address that is listened on.
        rules: Who may connect.
    """
    if ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        return
    where = f"usarmjx: warning: {address} is not this machine's loopback:"
    if rules.token:
        typer.echo(f"{where} the token crosses the network readable (docs/security.md has a proxy)", err=True)
    elif not rules.allow:
        typer.echo(
            f"{where} anybody who reaches it may drive robots, look through their cameras and take all "
            "seats; --allow says who may connect, --token asks for a secret (docs/security.md)",
            err=True,
        )
