"""Recordings: worlds kept in MCAP files, read again, and computed again to the last bit.

`Recording` reads a file and gives frames to the viewer, `check_recording` computes it again, `rows_of` and
`export_tables` make tables of it; `WorldRecorder` writes one. Private: `file` writes in a thread of its own,
`values` packs, `replay` repeats, `foxglove` has that viewer's schemas. Class and field names stand in users'
files: a renamed one keeps an alias in `values`. Begin with `recorder`, then `reader`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.recording.episodes import BlackBox as BlackBox
    from usarmjx.recording.reader import RecordedMessage as RecordedMessage
    from usarmjx.recording.reader import Recording as Recording
    from usarmjx.recording.recorder import WorldRecorder as WorldRecorder
    from usarmjx.recording.replay import ReplayResult as ReplayResult
    from usarmjx.recording.replay import check_recording as check_recording
    from usarmjx.recording.tables import COLUMNS as COLUMNS
    from usarmjx.recording.tables import export_tables as export_tables
    from usarmjx.recording.tables import rows_of as rows_of
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.recording.episodes": ("BlackBox",),
            "usarmjx.recording.reader": ("RecordedMessage", "Recording"),
            "usarmjx.recording.recorder": ("WorldRecorder",),
            "usarmjx.recording.replay": ("ReplayResult", "check_recording"),
            "usarmjx.recording.tables": ("COLUMNS", "export_tables", "rows_of"),
        },
    )
