"""From descriptions to a model: solids to geoms, names to indices, robots to tables for rays and sensors.

`compose_arena` and `compose` make the MjSpec, `layout` finds a robot in the compiled model once, and
`body_plan` is a robot's own kinematics, apart from any engine. `arena_set`, `victims`, `doors` and
`variation` are what differs between worlds without compiling again. Begin with `compose.add_robot`. The
order of bodies, joints and actuators that `compose` gives is relied on: `layout`, engines and saved
policies count in it.
"""
