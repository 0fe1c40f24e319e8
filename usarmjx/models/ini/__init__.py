"""Unreal's ini files, USARSim's configuration: changed and new robot classes (manual 12.1.2, 14.4.2).

Two steps: `parse` has the syntax and the types of values, the others the meaning of sections and keys for a
robot: `robots` sorts and loads them, `spec` builds one robot with `parameters`, `pairs` and `items`.
Begin with `robots.load_robots`. An unknown key becomes a warning with the reason
(`items.KNOWN_IGNORED`), a wrong value a `SpecError` with its line. Lengths in Unreal units are converted to
metres on reading.
"""
