"""What tasks are set in: generated buildings, robots with the sensors that a task reads, true clearances.

`buildings` draws arenas and knows which squares robots get to; `equip` gives robots their INS, scanner and
victim sensor; `clearance` measures, for evaluation only, how far robots truly are from what stands around
them. Nothing here knows of a particular task. Begin with `buildings.py`.
"""
