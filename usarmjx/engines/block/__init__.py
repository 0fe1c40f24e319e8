"""Solver `block` of engine `warp`: each island of constraint rows solved by its own lanes."""
