"""The robots' radio in one world: who hears whom, how strongly, and the messages that get through.

`RadioSettings` and `MessageSettings` set it up; `Links` is the table of all pairs, `Inboxes` what arrived.
`reachable`, `hops`, `bottleneck` and `connected_components` answer over several hops. All are pure functions
of arrays; `usarmjx.sim` decides when they run, and the server has the sockets. Private: `walls` and
`clipping` count what is between two robots, `attenuation` is the manual's formula. Begin with
`links.evaluate_links`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.comms.attenuation import RadioSettings as RadioSettings
    from usarmjx.comms.attenuation import WorldRadioSettings as WorldRadioSettings
    from usarmjx.comms.attenuation import link_range as link_range
    from usarmjx.comms.attenuation import received_power as received_power
    from usarmjx.comms.links import Links as Links
    from usarmjx.comms.links import bottleneck as bottleneck
    from usarmjx.comms.links import connected_components as connected_components
    from usarmjx.comms.links import evaluate_links as evaluate_links
    from usarmjx.comms.links import hops as hops
    from usarmjx.comms.links import reachable as reachable
    from usarmjx.comms.mail import DropCounts as DropCounts
    from usarmjx.comms.mail import Inboxes as Inboxes
    from usarmjx.comms.mail import MessageSettings as MessageSettings
    from usarmjx.comms.mail import OutgoingMessages as OutgoingMessages
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.comms.attenuation": (
                "RadioSettings",
                "WorldRadioSettings",
                "link_range",
                "received_power",
            ),
            "usarmjx.comms.links": (
                "Links",
                "bottleneck",
                "connected_components",
                "evaluate_links",
                "hops",
                "reachable",
            ),
            "usarmjx.comms.mail": ("DropCounts", "Inboxes", "MessageSettings", "OutgoingMessages"),
        },
    )
