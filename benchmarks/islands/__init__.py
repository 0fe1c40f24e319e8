"""Solver `block` beside C MuJoCo: random states of all robots in all arenas.

`states` makes the states, `rows` puts the constraint rows that C MuJoCo finds there into the arrays that the
solver reads, `compare` measures the errors and `optimum` says where they come from. Begin with
`python -m benchmarks.islands --help`.
"""
