"""Engine `planar`: robots as footprints that roll, slide along walls and fly, without MuJoCo's solver.

`engine` is the engine, for whole worlds at once; `responses` says how each class answers its motors, from
data that `usarmjx calibrate` measures on engine `c` (`responses.json`); `drives` and `rolling` make
velocities of that, `flight` is for what flies or dives, `servos` for other joints; `solids` and `footprints`
are what robots stand on and stop at, `neighbours` keeps what is near each until robots or `movable` solids
come nearer, which is seen to in `few_worlds` at a time. `looking` and `parting` choose between that and
kernels of Warp, which read what robots would do as rows of numbers (`proposed`). Begin with
`engine.PlanarEngine`.
docs/fidelity.md says what it leaves out and by how much it is wrong.
"""
