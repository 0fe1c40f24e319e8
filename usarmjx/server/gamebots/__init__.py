"""Which message each sensor's reading becomes, and what GEO and CONF say of robots: tables, no state.

`sensors` has the manual's sensors, `victims` those that find victims and RFID tags, `generic` any other:
its quantities (`Sensor.quantities`) say how to write them, so a sensor of your own needs nothing here.
Readings come in our axes and leave in the wire's. Begin with `sensors.REPORTS`.
"""
