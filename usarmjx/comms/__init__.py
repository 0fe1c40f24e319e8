"""The radio: received power behind walls, links, messages over them, and who reaches whom."""
