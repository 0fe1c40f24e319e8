"""Served worlds; `served_world.ServedWorld` is the interface that the server uses.

`dynamic_world` is one world on C MuJoCo that robots of any class join and leave: its model is recompiled.
`batch_world` serves one world of a batch, whose shape is fixed: INIT activates a parked robot. In
`policy_world` a policy drives the robots that no client has claimed. `make` chooses by engine. Poses and
angles are in our axes; only the server's loop may call a world. Begin with `served_world`.
"""
