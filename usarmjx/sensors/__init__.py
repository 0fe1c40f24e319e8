"""Batched sensors: pure functions of what is where, never of the engine that moved it."""
