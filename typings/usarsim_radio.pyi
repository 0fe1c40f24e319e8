# The radio's file where it is copied beside a controller, without usarmjx.
from usarmjx.client.usarsim_radio import RadioError as RadioError
from usarmjx.client.usarsim_radio import RadioLink as RadioLink
from usarmjx.client.usarsim_radio import WirelessA as WirelessA
