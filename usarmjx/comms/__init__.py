"""The robots' radio in one world: who hears whom, how strongly, and the messages that get through.

Begin with `links.evaluate_links`, which makes the table of all pairs: `walls` (and `clipping` for meshes)
counts what is in between, `attenuation` turns distance and walls into power by the manual's formula,
`antenna` says where it is measured. `mail` delivers messages over links that hold, `connectivity` tells who
reaches whom over several hops. All are pure functions of arrays: when they run is up to `sim.radio`, and
sockets are the server's.
"""
