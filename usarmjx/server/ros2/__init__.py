"""ROS 2 without ROS: the topics and services of a served world over DDS or Zenoh.

Messages come from `rosbridge`. `transport` is what a middleware has to do, `dds_transport` and
`zenoh_transport` do it, in the thread of `worker`; `node` has the services of the world and of its
parameters, and `server` the service of the loop.
"""
