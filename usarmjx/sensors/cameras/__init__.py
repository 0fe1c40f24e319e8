"""Cameras: pictures by ray casting, with depth and labels, for batches and for the image server alike.

Begin with `picture.render_picture`: a `RenderScene` (what there is) and a `Viewpoint` (from where) make a
`Picture`. `mounts` finds the cameras and headlights of a robot class, `lenses` makes their rays, `casters`
says what these meet, with JAX, or on NumPy with the rays of C MuJoCo (`engines.c_sight`); `shading` colours
that, `light` and `paint` say how bright and of what colour; `lens_cover` finds what of its own robot a camera
must not see. `programs` compiles in the background, for accelerators. What is drawn over pictures is in
`sensors.sketch` and `server.pictures`.
"""
