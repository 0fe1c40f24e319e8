"""Small worlds of other simulators for tests of their readers."""

PYRAMID = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nf 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
"""A pyramid as an OBJ file."""


def write(path, text):
    """Write a file and return its path."""
    path.write_text(text)
    return path


def world(text, floor="<include><uri>model://ground_plane</uri></include>"):
    """A world of Gazebo with a content on a floor."""
    return f"<sdf version='1.9'><world name='w'>{text}{floor}</world></sdf>"
