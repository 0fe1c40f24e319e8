"""Engine `c`: C MuJoCo, which starts at once and is the oracle for the others.

`batch` steps the worlds of a batch one after another; `world` is one world whose robots come and go, with
`placement` (free start poses) and `faults` (recovery of a robot). `rays` and `camera_rays` cast rays,
of several robots at once at the geoms near them. Begin with `batch.CEngine`.
"""
