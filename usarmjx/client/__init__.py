"""The client library: robots, radio and pictures over the original's ports, by the standard library alone.

`usarsim_client` is one file that can be copied beside a controller where usarmjx is not installed;
`usarsim_radio`, the radio, goes beside it. `wander` is a controller made with it, which drives a P2AT by its
sonars. Nothing here imports the rest of usarmjx. Begin with `usarsim_client.UsarsimClient`.
"""

from usarmjx.client.usarsim_client import CameraClient as CameraClient
from usarmjx.client.usarsim_client import Image as Image
from usarmjx.client.usarsim_client import ServerMessage as ServerMessage
from usarmjx.client.usarsim_client import UsarsimClient as UsarsimClient
from usarmjx.client.usarsim_client import format_line as format_line
from usarmjx.client.usarsim_client import parse_line as parse_line
from usarmjx.client.usarsim_radio import RadioDoor as RadioDoor
from usarmjx.client.usarsim_radio import RadioError as RadioError
from usarmjx.client.usarsim_radio import RadioLink as RadioLink
from usarmjx.client.usarsim_radio import WirelessA as WirelessA
from usarmjx.client.usarsim_radio import WirelessB as WirelessB
