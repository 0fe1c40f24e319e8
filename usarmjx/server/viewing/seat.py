"""Who at the page may have its controls at all."""

import ipaddress

from usarmjx.server.access import AccessRules
from usarmjx.view.controls import ControlSeat


def control_seat(address: str, rules: AccessRules, wanted: bool = False) -> ControlSeat:
    """Return the seat of a page's controls.

    People can take it where only this machine can open the page, or only who knows the token; elsewhere only
    if the operator wants that.

    Args:
        address: IP address that the page is listened on.
        rules: Who may connect.
        wanted: Whether everybody who can open the page may have its controls.
    """
    is_loopback = ipaddress.ip_address(address.partition("%")[0]).is_loopback
    return ControlSeat(allowed=wanted or is_loopback or bool(rules.token))
