# The client's file where it is copied beside a controller, without usarmjx.
from usarmjx.client.usarsim_client import AUTH as AUTH
from usarmjx.client.usarsim_client import ClientSocket as ClientSocket
from usarmjx.client.usarsim_client import ServerMessage as ServerMessage
from usarmjx.client.usarsim_client import UsarsimClient as UsarsimClient
from usarmjx.client.usarsim_client import connect as connect
from usarmjx.client.usarsim_client import format_line as format_line
from usarmjx.client.usarsim_client import parse_line as parse_line
