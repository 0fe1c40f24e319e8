"""The raycaster that sensors and cameras share: what rays meet first among geoms of all kinds.

Begin with `raycast`: `cast_rays` and its `RayQuery`, which every backend honours whole. `kernels` has a small
function per kind of geom, `targets` the geoms as arrays, `bundles` the cones that leave out what rays cannot
meet, `raycast_warp` the GPU's kernel, which `base.warp_functions` chooses where Warp is installed. A new kind
of geom is a kernel in `kernels` and in `warp_kinds`, and its bounding box and normal, in `kernels`; C
MuJoCo's `mj_ray` is the oracle of everything here.
"""
