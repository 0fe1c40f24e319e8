"""Pictures for people: plans and views of arenas, portraits, what sensors see, runs, training curves.

`picture` draws a demonstration's run, `floor_plan` and `gallery` arenas, `portrait` robots, `radio_map`
signal strength, `sensor_plots` with `sensor_studies` and `camera_plots` the pictures of docs/sensors.md,
`training_plots` curves, `play` a policy at work. `render` is a picture by the sensors' raycaster.
Matplotlib is used through its canvas, never pyplot, so that nothing global changes. Begin with
`floor_plan.draw_plan`.
"""
