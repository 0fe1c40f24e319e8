"""The worlds that are served; what the server asks of one is `host.ServedWorld`.

`dynamic_world` is one world on C MuJoCo where robots of any class come and go: its model is recompiled,
sensors are compiled once per class (`compiled`). `batch_world` serves one world of a batch, whose shape is
fixed: INIT activates a parked robot. In `policy_world` a policy drives the robots that nobody has claimed.
`make` chooses by engine. Poses and angles are in our axes; nobody but the server's loop may call a world.
Begin with `host`.
"""
