"""The server: clients that speak USARSim's protocols drive robots of served worlds, and others watch.

`serve` begins it in the background and returns a `Serving`; `add_command` adds a command of one's own, which
gets a `ServedWorld` and a `Message`. Private: `runtime` steps the worlds in time with the clock, `network`
has ports, `gamebots` the robots' dialogue, `protocol` the grammar without sockets, `worlds` what is served,
`pictures`, `wireless`, `viewing` and `rosbridge` further services. Text on the wire is as captured from the
original servers or as in the manual: it changes only with such a source. Begin at
`gamebots.server.BotServer.tick`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.server.gamebots.adapter import CommandAction as CommandAction
    from usarmjx.server.gamebots.adapter import add_command as add_command
    from usarmjx.server.gamebots.sensors import configuration as configuration
    from usarmjx.server.gamebots.sensors import sensor_report as sensor_report
    from usarmjx.server.protocol.grammar import Message as Message
    from usarmjx.server.protocol.grammar import format_message as format_message
    from usarmjx.server.protocol.grammar import parse_message as parse_message
    from usarmjx.server.runtime.background import Serving as Serving
    from usarmjx.server.runtime.background import serve as serve
    from usarmjx.server.worlds.make import make_worlds as make_worlds
    from usarmjx.server.worlds.served_world import ServedWorld as ServedWorld
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.server.gamebots.adapter": ("CommandAction", "add_command"),
            "usarmjx.server.gamebots.sensors": ("configuration", "sensor_report"),
            "usarmjx.server.protocol.grammar": ("Message", "format_message", "parse_message"),
            "usarmjx.server.runtime.background": ("Serving", "serve"),
            "usarmjx.server.worlds.make": ("make_worlds",),
            "usarmjx.server.worlds.served_world": ("ServedWorld",),
        },
    )
