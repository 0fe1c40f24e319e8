"""A client in a terminal: commands with completion, messages in panes, driving by keyboard or joystick.

It speaks the Gamebots protocol as any client does, by the server's own grammar, and knows neither JAX nor the
simulator, so that it starts at once. Begin with `client` (a connection, and lines without
panes) and `app`.
"""
