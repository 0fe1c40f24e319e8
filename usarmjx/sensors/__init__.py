"""Sensors: what each type measures on one robot, as pure functions that a batch maps over robots and worlds.

On NumPy they run for one robot at a time, and only those that are due (`base.backend`).

`base.Sensor` says what a sensor is: begin there, then read `ranging` as an example. One module per family
registers its types in `base.SENSORS`; `suite.Suite` reads all of a robot class together, each when it is due.
`rays` casts their rays, `surroundings` knows victims and tags, `noise` and `quantities` are shared by all.
A new type is one more module and needs nothing else (docs/own-sensor.md); settings are fields with limits and
the manual's keys (`models.spec.settings`). Nothing here knows of worlds, groups or the wire.
"""
