"""Compilation of descriptions to a MuJoCo model, and to tables for rays and sensors.

`compose` makes the MjSpec, its `index_robot` looks up a robot's indices in the compiled model once, and
`kinematic_tree` has a robot's own kinematics, apart from any engine. `arena_set`, `victims` and
`randomization` hold the data that differs between worlds without recompilation. Begin with
`compose.add_robot`. The order of bodies, joints and actuators that `compose` gives is an interface:
`index_robot`, engines and saved policies depend on it.
"""
