"""What happens in a tick: one world as pure functions, and many worlds at once.

`scene` is fixed: an arena with its robots, compiled. `world` is what changes, with the functions of a control
step; `reset` starts it, `actions` tells its robots what to do; `operate`, `radio`, `visible` and `views` are
parts of it. Only `batch` maps over worlds and compiles. What gets a `World` is traced: no branching on values
there, and random numbers come from the key of a `streams.Stream`. Begin with `batch.Batch`, then
`world.compute_inputs` and `world.observe`.
"""
