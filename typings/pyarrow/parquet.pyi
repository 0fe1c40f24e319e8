# What exports need of pyarrow.parquet.
from pathlib import Path
from typing import Any

from pyarrow import Table

def write_table(table: Table, where: str | Path) -> None: ...
def __getattr__(name: str) -> Any: ...
