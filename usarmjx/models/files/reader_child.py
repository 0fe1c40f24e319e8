"""Program of the process that reads files for `reader_process`; it imports nothing of usarmjx.

A line of JSON on its input names a file and its kind; a line of JSON on its output holds the result, followed
by as many bytes as the line announces. A crash, an endless loop or a flood of memory ends only this process.
"""

import contextlib
import json
import os
import re
import select
import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any, BinaryIO

ALLOCATION_ERROR = "Caught an unknown exception"
"""MuJoCo's message when an allocation fails."""
MAX_MODEL_SIZES = {
    **dict.fromkeys(("ngeom", "nbody", "nsite", "njnt"), 50_000),
    "nhfielddata": 1_000_000,
    "nmeshvert": 3_000_000,
    "ntexdata": 256_000_000,
    "nuserdata": 1_000_000,
}
"""Largest sizes of a model: those of `xml_file`, for files whose XML is readable only by MuJoCo."""
MAX_MODEL_VALUES = {
    **dict.fromkeys(
        ("body_pos", "body_ipos", "geom_pos", "geom_size", "jnt_pos", "mesh_vert", "hfield_size"), 1e7
    ),
    **dict.fromkeys(("body_mass", "body_inertia", "dof_damping", "dof_armature", "jnt_range"), 1e25),
}
"""Bounds of the numbers in a model's arrays: finite, also when cubed."""
LOADING: dict[str, dict[str, Any]] = {
    "obj": {"process": False, "maintain_order": True, "skip_materials": True, "split_objects": True},
    "stl": {"process": False},
    "dae": {"process": False, "resolver": None},
    "ply": {"process": False, "resolver": None},
    "glb": {"process": False, "resolver": None},
}
"""Options of trimesh by kind of mesh file, which keep the file's order and vertices."""
BINDINGS = re.compile(rb"<bind_material\b.*?</bind_material\s*>", re.DOTALL)
MATERIAL_USE = re.compile(rb"""<instance_material\b[^>]*\btarget\s*=\s*["']#([^"']*)["']""")
MATERIAL_ID = re.compile(rb"""<material\b[^>]*\bid\s*=\s*["']([^"']*)["']""")
"""Materials of a COLLADA file: those of one mesh, the use of one, and its definition."""
CUTTING = {"threshold": 0.05, "mcts_iterations": 60, "mcts_nodes": 10, "resolution": 1000}
"""Options of coacd: its default of the concavity, a shorter search."""


OPTIONS: tuple[list[str], int, int, float] = (
    json.loads(sys.argv[1]) if __name__ == "__main__" else ([], 0, 0, 0)
)
SEARCH_PATH, CPU_TIME, MEMORY, IDLE = OPTIONS
"""Module search path; limits for one file [s], [bytes]; time without requests after which to end [s]."""


def limit() -> None:
    """Lower this process's limits to the allowance of the next file, where the system has limits.

    Each call adds an allowance to the present use: a limit covers all files of the process together.
    """
    try:
        import resource
    except ImportError:
        return
    # A second more: the limit counts whole ones.
    end = int(time.process_time()) + 1 + CPU_TIME
    # Readers have no file to write.
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (end if most < 0 else min(end, most), most))
    with contextlib.suppress(OSError, ValueError):  # no such file, or a system that has not this limit
        with open("/proc/self/statm") as file:
            size = int(file.read().split()[0]) * resource.getpagesize()
        # The soft limit alone: it can be raised again for the next file, the hard one cannot.
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        wanted = size + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (wanted if most < 0 else min(wanted, most), most))


def try_model(path: str, text: str = "") -> tuple[dict[str, object], list[Any]]:
    """Compile an MJCF or URDF file, or the MJCF text made of a file, and allocate its data."""
    import mujoco

    limit()
    warned: list[str] = []
    # MuJoCo's default handler appends warnings to a file, MUJOCO_LOG.TXT.
    mujoco.set_mju_user_warning(warned.append)
    spec: Any = mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(path)
    spec.memory = spec.njmax = spec.nconmax = -1  # room for contacts of the file's own program
    if text:  # MuJoCo writes six digits: inertias at the limit of balance, and tiny ones, would be beyond it
        compiler = spec.compiler
        compiler.balanceinertia, compiler.boundmass, compiler.boundinertia = True, 1e-9, 1e-12
    model = spec.compile()
    if wrong := [text for text in warned if "NaN" in text]:
        raise ValueError(wrong[0])
    for name, most in MAX_MODEL_SIZES.items():
        if getattr(model, name) > most:
            raise ValueError(f"it makes {getattr(model, name)} of {name}; at most {most}")
    for name, most in MAX_MODEL_VALUES.items():
        array = getattr(model, name)
        # In this form: NaN is refused as well.
        if array.size and not abs(array).max() <= most:
            raise ValueError(f"it has {name} up to {abs(array).max():g}; at most {most:g}")
    # Allocated and dropped: a small model may need huge data.
    mujoco.MjData(model)
    return {}, []


def read_mesh(path: str) -> tuple[dict[str, object], list[Any]]:
    """Read a mesh file's objects: their names, and vertices and faces of each."""
    import numpy as np
    import trimesh

    kind = path[-3:].lower()
    if kind == "dae":
        import_module("collada")  # trimesh reads with it, and without it reports another error
    limit()
    with open(path, "rb") as file:
        scene: Any = trimesh.load_scene(  # pyright: ignore[reportUnknownMemberType]
            _as_utf8(file, kind), file_type=kind, **LOADING[kind]
        )
    if kind in ("dae", "glb"):
        found = _placed_objects(scene)
    else:
        found = [(str(name), scene.geometry[name]) for name in sorted(scene.geometry)]
    arrays = [
        np.ascontiguousarray(array, kind)
        for _, mesh in found
        for array, kind in ((mesh.vertices, "<f8"), (mesh.faces, "<i8"))
    ]
    names = [name for name, _ in found]
    return {"names": names, "shapes": [array.shape for array in arrays]}, arrays


def read_pieces(path: str, count: int, scale: list[float]) -> tuple[dict[str, object], list[Any]]:
    """Cut the objects of a mesh file, scaled, into convex pieces, at most some of each: their vertices."""
    import numpy as np

    coacd: Any = import_module("coacd")
    coacd.set_log_level("error")
    _, arrays = read_mesh(path)
    found: list[Any] = []
    for vertices, faces in zip(arrays[::2], arrays[1::2], strict=True):
        # A mirrored mesh has its faces inside out.
        outward = faces if np.prod(scale) > 0 else faces[:, ::-1]
        mesh = coacd.Mesh(vertices * np.array(scale), outward)
        found += [pair[0] for pair in coacd.run_coacd(mesh, max_convex_hull=count, seed=0, **CUTTING)]
    pieces = [np.ascontiguousarray(piece, "<f8") for piece in found]
    return {"shapes": [piece.shape for piece in pieces]}, pieces


def _placed_objects(scene: Any) -> list[tuple[str, Any]]:  # noqa: ANN401 - trimesh.Scene
    """Return the meshes of a COLLADA or glTF scene in metres, each where its nodes put it.

    As ROS and Gazebo do, the scene's unit counts and its upward axis does not.
    """
    found: list[tuple[str, Any]] = []
    # Sorted: the order must not depend on how trimesh walks the graph.
    for node in sorted(scene.graph.nodes_geometry):
        transform, name = scene.graph[node]
        # A copy: several nodes may place the same mesh.
        mesh = scene.geometry[name].copy()
        if not hasattr(mesh, "faces"):
            continue
        unit = str(mesh.metadata.get("units") or "").partition(" * ")
        mesh.apply_transform(transform)
        if unit[1]:
            mesh.apply_scale(float(unit[0]))
        found.append((str(node), mesh))
    return found


def read_xacro(path: str, arguments: Any) -> tuple[dict[str, object], list[Any]]:  # noqa: ANN401 - JSON
    """Expand a xacro file without ROS; packages are the folders of the arguments, or found by their names."""
    # The package has no types, and no public way to say where packages are.
    xacro: Any = import_module("xacro")
    substitutions: Any = import_module("xacro.substitution_args")
    limit()
    folders: dict[str, str] = arguments["folders"]
    missing: list[str] = []

    def find(package: str) -> str:
        if package not in folders:
            missing.append(package)
            raise ValueError(f"no folder is found for package {package!r}")
        return folders[package]

    # `$(find ...)` and `$(eval ...)` look it up in two places.
    substitutions._eval_find = find
    substitutions._eval_dict["find"] = find
    try:
        document = xacro.process_file(path, mappings=arguments["mappings"])
    except Exception as error:
        if missing:
            return {"package": missing[0]}, []
        raise ValueError(f"{type(error).__name__}: {error}") from error
    text = document.toprettyxml(indent=" ").encode()
    return {}, [text]


def _as_utf8(file: BinaryIO, kind: str) -> BinaryIO:
    """Return a text file with invalid UTF-8 replaced; trimesh would need another module for that.

    COLLADA that lacks a material comes without any: trimesh leaves out meshes whose material is missing.
    """
    import io

    data = file.read()
    if kind == "dae" and not set(MATERIAL_USE.findall(data)) <= set(MATERIAL_ID.findall(data)):
        data = BINDINGS.sub(b"", data)
    if kind in ("dae", "ply", "glb") or (kind == "stl" and b"\0" in data):
        return io.BytesIO(data)
    return io.BytesIO(data.decode("utf-8", "replace").encode())


READERS: dict[str, Callable[..., tuple[dict[str, object], list[Any]]]] = {
    "model": try_model,
    "mesh": read_mesh,
    "xacro": read_xacro,
    "pieces": read_pieces,
}
"""Reader of each kind of file."""


def answer(line: bytes) -> tuple[dict[str, object], list[Any]]:
    """Return the result of reading a file: its values, or under "error" the reason of failure.

    Under "extra" is the extra that brings a missing library.
    """
    kind, path, *arguments = json.loads(line)
    try:
        return READERS[kind](path, *arguments)
    except ModuleNotFoundError as error:
        extra = "decomposition" if error.name == "coacd" else "robots"
        return {"error": f"{error.name} is not installed", "extra": extra}, []
    except MemoryError:
        return {"error": f"reading it takes more than {MEMORY // 1_000_000} MB of memory"}, []
    except Exception as error:  # readers raise whatever they run into
        reason = " ".join(str(error).split())[:500] or type(error).__name__
        if ALLOCATION_ERROR in reason:
            reason = f"MuJoCo gives no reason, as where {MEMORY // 1_000_000} MB of memory do not suffice"
        return {"error": reason}, []


def main() -> None:
    """Answer line by line, until no request comes for `IDLE` seconds."""
    sys.path[:] = SEARCH_PATH
    # The answers keep the old standard output under another number.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # prints of the readers must not mix with answers
    # On Windows select works with sockets only: there the process waits until its input closes.
    while os.name == "nt" or select.select([0], [], [], IDLE)[0]:
        line = sys.stdin.buffer.readline()
        if not line:
            return
        values, arrays = answer(line)
        body = [array if isinstance(array, bytes) else array.tobytes() for array in arrays]
        head = {**values, "bytes": sum(map(len, body))}
        out.write(json.dumps(head).encode() + b"\n" + b"".join(body))
        out.flush()


if __name__ == "__main__":
    main()
