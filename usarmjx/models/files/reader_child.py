"""The program of the process that reads files for `reader_process`; it imports nothing of usarmjx.

A line of JSON on its input names a file and how to read it; a line of JSON on its output says what came of
it, with as many bytes behind it as the line says. A crash, an endless loop or a flood of memory ends this
process and no other.
"""

import contextlib
import json
import os
import select
import sys
import time
from collections.abc import Callable
from typing import Any, BinaryIO

UNKNOWN = "Caught an unknown exception"
"""What MuJoCo says where it gets no memory."""
MOST_MADE = {
    **dict.fromkeys(("ngeom", "nbody", "nsite", "njnt"), 50_000),
    "nhfielddata": 1_000_000,
    "nmeshvert": 3_000_000,
    "ntexdata": 256_000_000,
    "nuserdata": 1_000_000,
}
"""Sizes of a model: those of `mjcf_size`, for files that do not parse there and do here."""
LARGEST = {
    **dict.fromkeys(
        ("body_pos", "body_ipos", "geom_pos", "geom_size", "jnt_pos", "mesh_vert", "hfield_size"), 1e7
    ),
    **dict.fromkeys(("body_mass", "body_inertia", "dof_damping", "dof_armature", "jnt_range"), 1e25),
}
"""Arrays of a model, and what their numbers may be: finite, and so that their cubes are."""
LOADING: dict[str, dict[str, Any]] = {
    "obj": {"process": False, "maintain_order": True, "skip_materials": True, "split_objects": True},
    "stl": {"process": False},
}
"""Kinds of mesh files, and how trimesh shall read them: as they are."""


OPTIONS = json.loads(sys.argv[1]) if __name__ == "__main__" else ([], 0, 0, 0)
SEARCH_PATH, CPU_TIME, MEMORY, IDLE = OPTIONS
"""Where modules are; what reading one file may take [s], [bytes]; after how long without one to end [s]."""


def limit() -> None:
    """Lower this process' limits to what the next file may take, where the system has limits."""
    try:
        import resource
    except ImportError:
        return
    end = int(time.process_time()) + 1 + CPU_TIME
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (end if most < 0 else min(end, most), most))
    with contextlib.suppress(OSError, ValueError):  # no such file, or a system that has not this limit
        with open("/proc/self/statm") as file:
            size = int(file.read().split()[0]) * resource.getpagesize()
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        wanted = size + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (wanted if most < 0 else min(wanted, most), most))


def try_model(path: str) -> tuple[dict[str, object], list[Any]]:
    """Compile an MJCF or URDF file, and make the data that goes with it."""
    import mujoco

    limit()
    warned: list[str] = []
    # MuJoCo would write them to a file.
    mujoco.set_mju_user_warning(warned.append)
    model = mujoco.MjSpec.from_file(path).compile()
    if wrong := [text for text in warned if "NaN" in text]:
        raise ValueError(wrong[0])
    for name, most in MOST_MADE.items():
        if getattr(model, name) > most:
            raise ValueError(f"it makes {getattr(model, name)} of {name}; at most {most}")
    for name, most in LARGEST.items():
        array = getattr(model, name)
        if array.size and not abs(array).max() <= most:
            raise ValueError(f"it has {name} up to {abs(array).max():g}; at most {most:g}")
    mujoco.MjData(model)
    return {}, []


def read_mesh(path: str) -> tuple[dict[str, object], list[Any]]:
    """Read a mesh file's objects: their names, and vertices and faces of each."""
    import numpy as np
    import trimesh

    limit()
    kind = path[-3:].lower()
    with open(path, "rb") as file:
        scene: Any = trimesh.load_scene(_as_utf8(file, kind), file_type=kind, **LOADING[kind])
    found = [(str(name), scene.geometry[name]) for name in sorted(scene.geometry)]
    arrays = [
        np.ascontiguousarray(array, kind)
        for _, mesh in found
        for array, kind in ((mesh.vertices, "<f8"), (mesh.faces, "<i8"))
    ]
    names = [name for name, _ in found]
    return {"names": names, "shapes": [array.shape for array in arrays]}, arrays


def _as_utf8(file: BinaryIO, kind: str) -> BinaryIO:
    """Return a text file with what is no UTF-8 in it replaced; trimesh would want another module for that."""
    import io

    data = file.read()
    if kind == "stl" and b"\0" in data:
        return io.BytesIO(data)
    return io.BytesIO(data.decode("utf-8", "replace").encode())


READERS: dict[str, Callable[[str], tuple[dict[str, object], list[Any]]]] = {
    "model": try_model,
    "mesh": read_mesh,
}


def answer(line: bytes) -> tuple[dict[str, object], list[Any]]:
    """Return what came of reading a file: the values it has, or under "error" what is wrong with it."""
    kind, path = json.loads(line)
    try:
        return READERS[kind](path)
    except MemoryError:
        return {"error": f"reading it takes more than {MEMORY // 1_000_000} MB of memory"}, []
    except Exception as error:  # readers raise whatever they run into
        said = " ".join(str(error).split())[:500] or type(error).__name__
        if UNKNOWN in said:
            said = f"MuJoCo gives no reason, as where {MEMORY // 1_000_000} MB of memory do not suffice"
        return {"error": said}, []


def main() -> None:
    """Answer line by line, until nobody asks any more."""
    sys.path[:] = SEARCH_PATH
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the readers print is no answer
    while os.name == "nt" or select.select([0], [], [], IDLE)[0]:
        line = sys.stdin.buffer.readline()
        if not line:
            return
        values, arrays = answer(line)
        body = [array.tobytes() for array in arrays]
        head = {**values, "bytes": sum(map(len, body))}
        out.write(json.dumps(head).encode() + b"\n" + b"".join(body))
        out.flush()


if __name__ == "__main__":
    main()
