"""ROS 2 without ROS: the topics and services of a served world over DDS or Zenoh.

Messages come from `rosbridge`. `transport` is what a middleware has to do, `dds_transport` and
`zenoh_transport` do it, in the thread of `worker`; `type_hash` has the hashes of types, `parameters` the
services of a node's parameters, `node` the services of the world, and `server` the service of the loop.
"""
