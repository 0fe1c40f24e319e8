"""Robots and arenas as data, and their composition into one MuJoCo model."""
