"""The server: clients that speak USARSim's protocols drive robots of one world, and others watch.

`net.py` is the loop: it steps the world in time with the clock, reads sockets, and calls `tick` of whatever
else is served, the radio and the pictures. Begin at `BotServer._tick`, then `adapter.Client`, which carries
out a client's commands on a `worlds.served_world.ServedWorld` and makes its reports. What a line means is in
`protocol`, which knows neither sockets nor JAX; what a sensor says is in `messages`. Text on the wire is as
captured from the original servers or as in the manual: change it only with such a source.
"""
