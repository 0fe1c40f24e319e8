"""Unreal's ini files, by which USARSim is configured: robots changed and made anew (manual 12.1.2, 14.4.2).

Three steps: `parse` knows the syntax, `read` the types of values, the others what sections and keys mean to
a robot: `sort` first, then `spec` with `figures`, `pairs`, `joints`, `drive`, `items`, `packages`. Begin
with `robots.load_robots`. A key that means nothing here is a warning that says why (`keys`), a value that
is wrong a `SpecError` with its line. Lengths are in Unreal units, and turned into metres where they are
read.
"""
