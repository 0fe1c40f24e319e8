"""Arenas and robots from files of other tools, and arenas back to files.

`load` and `save` are the way in and out: an arena's YAML file (`yaml_file`), whose fields are read by the
type hints of the dataclasses (`fields`) and which may take solids from MJCF, URDF, meshes, terrain and maps
(`sources`). `robot_mjcf` makes a robot of an MJCF file. Every mistake of a file is an `ArenaFileError` or a
`SpecError` that names file and line (`values`): what an arena cannot have is refused or left out with a
warning, never guessed.
"""
