"""Engine `planar`: robots as footprints that roll, slide along walls and fly, without MuJoCo's solver.

`engine` steps whole batches. `drives`, `rolling` and `responses` (measured on engine `c` by `usarmjx
calibrate`, packaged in `responses.json`) turn wheel speeds into velocities; `flight` moves flying and diving
robots, `bodies` their other joints. `solids` and `footprints` are the obstacles and the robots;
`neighbor_lists` keeps the solids near each robot until robots or movable solids come closer.
`neighbor_search` and `engine.separate_robots` run on JAX or as Warp kernels, which read a `proposed_motion`
as rows of numbers. Begin with `engine.PlanarEngine`; docs/fidelity.md lists the simplifications and their
errors.
"""
