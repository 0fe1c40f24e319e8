"""Recordings: worlds kept in MCAP files, read again, and computed again to the last bit.

`recorder` is told by running worlds what happens, `file` writes it in a thread of its own, `reader` gives it
back as a `view.drawing.FrameSource`, and `replay` repeats it.
"""
