"""Sweeps: many cells, each a task with one configuration, played in as few batches as possible.

`spec` reads a file and expands it to the settings of cells (`settings` says which there are), `resolve` makes
a task, arenas and ranges of them, `plan` puts cells that differ in data only into groups, `batch` plays the
cells of a group as worlds of one environment, `workers` says where, `store` keeps each finished cell in a
file. `table`, `axis_scores`, `answers`, `report` and `figures` say what came of it, `bench_record` what it
took. A cell's result may depend on its settings alone, never on what else is in its batch: whoever changes
`resolve.signature_of` or `batch` keeps that. Begin with `run.run_sweep`.
"""
