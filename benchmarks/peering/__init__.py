"""Other simulators beside ours, on one machine in one run: `usarmjx bench peers`.

`peers` reads the folders of benchmarks/peers (what a peer is, as data) and makes their environments, `ours`
is this package measured in a process as they are, `contest` runs all in turn and writes the record. A peer's
`measure.py` imports nothing of usarmjx. Every rate lists the contents of its step; begin with `contest`.
"""
