"""Robots as ROS sees them: the rosbridge protocol over websockets, with standard messages, without ROS.

`definitions` are the messages' fields, `topics` what a world offers, made by `motion`, `readings` and
`floor_map`, `images` and `lens`, which go out by `encodings` and `serialisation`; `velocity` turns Twist into
DRIVE; `session` is a client's dialogue, without sockets; `services`
are the services, and `net` the sockets.
"""
