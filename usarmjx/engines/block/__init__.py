"""Solver `block` of engine `warp`: each group of robots and objects that touch is solved to convergence.

`coverage` says which scenes it covers; MuJoCo Warp's solver takes the others. `islands` sorts the constraint
rows of a world by the kinematic trees that they couple, and `newton` solves each of these islands: both are
native code, for a GPU's threads and for a CPU. `solver` makes kernels of them and launches them. Begin with
`solver.solve`, which takes the place of MuJoCo Warp's function of that name. `broad_phase` finds the pairs of
geoms that may touch.
"""
