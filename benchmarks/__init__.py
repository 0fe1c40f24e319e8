"""Measurements of `usarmjx bench`: one module for each benchmark, a frozen case in, a record (a dict) out.

`step` is the whole simulation, `rays`, `radio` and `camera` its parts, `train` a run of training; `peer` is
MuJoCo Warp's renderer, to compare with. `serve` is what many clients of `usarmjx serve` meet, with the means
in `serving`. Every record says on what and with which versions (`tools.record_header`) and goes to a file of
benchmarks/, whose README explains the figures: do not change what a key of a record means. Measured is after
compilation (but by `serve`, where it counts), and until the device is done. Begin with `tools`, then `radio`.
"""
