"""The command line: `app` lists the commands, and each has a file of its name (`list` is in `listing`).

A command's file holds its options and little else; heavy imports stand inside the functions, so that
`--help` answers at once. What the commands print is in `catalogue`, `arena_tables` and `sensor_tables`,
whose output is also docs/all-robots.md and the like; what `usarmjx demo` runs and measures is in
`demo_run`, what commands that serve share in `hosting`, `service_options` and `serve_run`. `tools` has the shared options and
`ErrorExit`, which makes one line and exit code 2 of our own errors. Begin with `serve`; `grouping` makes one option of each field of the dataclasses that it takes.
"""
