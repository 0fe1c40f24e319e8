"""The loop that serves worlds: its clock, its logs and metrics, and how it ends."""
