"""Cameras: raycasters with colour."""
