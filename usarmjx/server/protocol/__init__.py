"""The Gamebots and image protocols without sockets: bytes in, commands and messages out.

`grammar` cuts bytes into lines and converts a line to a `Message` and back, `command_parsers` converts a
message to a value of `commands`; `session` combines them and knows which command is legal in which phase.
`reports` and `descriptions` format the server's own lines; their numbers are in the wire's axes and units.
Nothing here imports JAX, asyncio or socket: a contract in pyproject.toml. Begin with
`session.RobotSession`; a new command starts in `commands`.
"""
