"""The Gamebots and image protocols without sockets: bytes in, commands and messages out.

`lines` cuts bytes into lines, `grammar` makes a `Message` of a line and back, `command_parsers` a value of
`commands` of a message; `session` puts them together and knows what is legal when. `reports` and
`descriptions` are what the server says; numbers are in the wire's axes (`frames`) and units. Nothing here
imports JAX, asyncio or socket: a contract in pyproject.toml. Begin with `session.RobotSession`; a new
command starts in `commands`.
"""
