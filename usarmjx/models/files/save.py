"""An arena to a YAML file, with its meshes and terrain in files beside it."""

from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.files import write_beside
from usarmjx.models.files.images import write_heights
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.shapes import HeightField, Mesh

HEADER = "# An arena of usarmjx. Lengths in metres, angles in radians; x forward, y left, z up.\n"
WIDTH = 110


def save_arena(arena: ArenaSpec, path: str | Path) -> Path:
    """Write an arena as a YAML file that `load_arena` reads as an equal one; return its path.

    Meshes go into OBJ files beside it, terrain into PNG files of 16 bits, whose heights are rounded to a
    65535th of the highest one. All numbers else are kept to the last digit.

    Raises:
        ArenaFileError: A name that does not end in .yaml, or a folder that is not there.
        WriteError: The folder cannot be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ArenaFileError(f"{path}: arenas are saved as .yaml files")
    if not path.parent.is_dir():
        raise ArenaFileError(f"{path}: cannot be written: No such file or directory")
    plain = _Files(path).plain(arena)
    text = yaml.safe_dump(plain, default_flow_style=None, sort_keys=False, width=WIDTH, allow_unicode=False)
    with write_beside(path) as fresh:
        fresh.write_text(HEADER + text, encoding="utf-8")
    return path


class _Files:
    """Turns values into what YAML has, and writes the files that they name.

    Args:
        path: The YAML file; the others are beside it and begin with its name.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._known = path, {}

    def plain(self, value: Any) -> Any:  # noqa: ANN401 - any field's value
        """Return a value as mappings, lists and scalars; fields that have their defaults are left out."""
        if isinstance(value, (Mesh, HeightField)):
            if id(value) not in self._known:
                self._known[id(value)] = _write(value, self._path, len(self._known))
            return self._known[id(value)]
        if is_dataclass(value):
            pairs = [(field, getattr(value, field.name)) for field in fields(value)]
            return {
                field.name: self.plain(held)
                for field, held in pairs
                if field.default is MISSING or held != field.default
            }
        if isinstance(value, (tuple, list)):
            return [self.plain(item) for item in value]
        return value.item() if isinstance(value, np.generic) else value


def _write(value: Mesh | HeightField, path: Path, number: int) -> object:
    return (
        _write_mesh(value, path, number) if isinstance(value, Mesh) else _write_terrain(value, path, number)
    )


def _write_mesh(mesh: Mesh, path: Path, number: int) -> str | dict[str, str]:
    """Write the corners and the faces, its own or those of their hull; return what names them."""
    vertices = np.asarray(mesh.vertices, float)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    if mesh.faces is None:
        lines += _hull_lines(vertices)
    else:
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    name = f"{path.stem}-mesh-{number}.obj"
    with write_beside(path.parent / name) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="ascii")
    return {"file": name, "rays": "faces"} if mesh.faces is not None else name


def _hull_lines(vertices: np.ndarray) -> list[str]:
    """Return the faces of corners' hull as lines of an OBJ file."""
    from scipy.spatial import ConvexHull

    hull, lines = ConvexHull(vertices), list[str]()
    for (a, b, c), outward in zip(hull.simplices.tolist(), hull.equations[:, :3], strict=True):
        normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        first, second = (b, c) if normal @ outward > 0 else (c, b)
        lines.append(f"f {a + 1} {first + 1} {second + 1}")
    return lines


def _write_terrain(terrain: HeightField, path: Path, number: int) -> dict[str, object]:
    """Write heights as grey values; return the file's name and what white is."""
    name = f"{path.stem}-heights-{number}.png"
    return {"file": name, "height": write_heights(path.parent / name, terrain.heights)}
