"""Import of arenas and robots from files of other tools, and export of arenas.

`load` reads and writes arenas: a YAML file (`yaml_file`), read by the type hints of the dataclasses, which
may take solids from MJCF, URDF, meshes, terrain and maps. `robot_file` makes a robot of a file. Every mistake
of a file is an `ArenaFileError` or a `SpecError` with file and line: unsupported content is refused or left
out with a warning, never guessed.
"""
