"""Descriptions of robots and arenas: frozen dataclasses without behaviour.

`robot` holds the parts and joints of a robot and the overrides of a mount, `shapes` the solids of both,
`arena` the contents of an arena. YAML files read and write a new field without further code
(`models.files.yaml_file`); give it a default, or files written before it no longer load.
"""
