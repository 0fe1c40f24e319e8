"""Sweeps: many cells, each a task with one configuration, played in as few batches as possible.

`sweep` plays a file's cells and returns the folder; `read_sweep` reads such a folder, `export_rows` writes
its table. Private: `spec` reads a file, `resolve` makes a task of a cell's settings, `run` groups cells that
differ in data only, `batch` plays a group as worlds of one environment, `workers` spreads groups, `store`
keeps each finished cell, `table`, `analysis`, `report` and `figures` describe the result. A cell's result
depends on its settings alone, never on its batch: a change of `resolve.signature_of` or `batch` keeps that.
Begin with `run.run_sweep`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.sweeps.run import run_sweep as run_sweep
    from usarmjx.sweeps.run import sweep as sweep
    from usarmjx.sweeps.spec import SweepSpec as SweepSpec
    from usarmjx.sweeps.spec import load_spec as load_spec
    from usarmjx.sweeps.store import CellRecord as CellRecord
    from usarmjx.sweeps.store import StoredSweep as StoredSweep
    from usarmjx.sweeps.store import read_sweep as read_sweep
    from usarmjx.sweeps.table import export_rows as export_rows
    from usarmjx.sweeps.workers import Workers as Workers
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.sweeps.run": ("run_sweep", "sweep"),
            "usarmjx.sweeps.spec": ("SweepSpec", "load_spec"),
            "usarmjx.sweeps.store": ("CellRecord", "StoredSweep", "read_sweep"),
            "usarmjx.sweeps.table": ("export_rows",),
            "usarmjx.sweeps.workers": ("Workers",),
        },
    )
