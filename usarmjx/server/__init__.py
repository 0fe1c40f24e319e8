"""The server: clients that speak USARSim's protocols drive robots of served worlds, and others watch.

`loop` steps the worlds in time with the clock. Each has a `net.BotServer`, which reads sockets and calls
`tick` of whatever else is served, the radio and the pictures; which ports they have is in `ports`, how all
that ends in `signals`. Begin at `BotServer.tick`, then `adapter.Client`, which carries out a client's
commands on a `worlds.served_world.ServedWorld` and makes its reports. What a line means is in `protocol`,
which knows neither sockets nor JAX; what a sensor says is in `messages`. Text on the wire is as captured
from the original servers or as in the manual: change it only with such a source.
"""
