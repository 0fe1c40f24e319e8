"""ROS view of a served world: the rosbridge protocol over websockets, with standard messages, without ROS.

`definitions` are the messages' fields, `topics` the topics of a world, with messages of sensors, cameras and
`motion`, which are sent in the `encodings`; `motion` also converts a Twist to DRIVE; `session` is a
client's dialogue, without sockets; `services` has the services, and `net` the sockets.
"""
