"""Engine `c`: C MuJoCo, which starts at once and is the oracle for the others.

`batch` steps the worlds of a batch one after another; `world` is one world whose robots come and go, with
`placement` (free start poses) and `faults` (recovery of a robot). `rays` and `camera_rays` cast rays,
`ray_pairs` those of several robots at geoms near them by the formulas of `ray_solids`, `moved_geoms` moves
geoms that differ between worlds. Begin with `batch.CEngine`.
"""
