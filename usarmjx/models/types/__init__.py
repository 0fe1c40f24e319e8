"""What robots and arenas are: frozen dataclasses, no code that depends on one of them.

`robot` has the parts and joints of a robot, `shapes` the solids of both, `arena` what stands and lies in an
arena, `settings` how a mount overrides a sensor's settings. A field added here reaches YAML files by itself
(`models.files.fields`); it needs a default, or files that were written before do not load any more.
"""
