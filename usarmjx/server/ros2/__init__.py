"""ROS 2 without ROS: the topics and services of a served world over DDS or Zenoh.

Messages come from `rosbridge`. `transport` is what a middleware has to do, `dds_transport` and
`zenoh_transport` do it, in the thread of `worker`; `server` has the node of a world, with its services and
parameters, and runs in the loop.
"""
