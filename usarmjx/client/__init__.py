"""The client library: robots, radio and pictures over the original's ports, by the standard library alone.

`usarsim_client` is one file that can be copied beside a controller where usarmjx is not installed;
`usarsim_radio`, the radio, goes beside it. `wander` is a controller made with it, which drives a P2AT by its
sonars. Nothing here imports the rest of usarmjx. Begin with `usarsim_client.UsarsimClient`.
"""

from usarmjx.client.usarsim_client import (
    CameraClient,
    Image,
    ServerMessage,
    UsarsimClient,
    format_line,
    parse_line,
)
from usarmjx.client.usarsim_radio import RadioDoor, RadioError, RadioLink, WirelessA, WirelessB

__all__ = [
    "CameraClient",
    "Image",
    "RadioDoor",
    "RadioError",
    "RadioLink",
    "ServerMessage",
    "UsarsimClient",
    "WirelessA",
    "WirelessB",
    "format_line",
    "parse_line",
]
