"""The command line: `app` lists the commands, and each has a file of its name (`list` is in `listing`).

A command's file holds its options and little else; heavy imports stand inside the functions, so that
`--help` answers at once. Options that several commands have are fields of dataclasses, each of which
`grouping` makes an option of its own: `hosting` and `service_options` for what serves, `policy_options` for
what tries a policy; single ones are in `tools`, with `ErrorExit`, one line and an exit code for our
own errors. What the commands print is in `catalogue`, `arena_tables` and `sensor_tables`, whose output is
docs/all-robots.md and the like, too; `demo_live` is what `usarmjx demo` shows, `demo_run` what it measures.
Old spellings of options are in `spelling`, names that shells complete in `completion`. Begin with `serve`.
"""
