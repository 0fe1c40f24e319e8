"""Programs that are kept as they were traced and lowered, so that the next start need not.

JAX keeps what XLA has compiled under a digest of the program, which it has to trace and lower to know. For
what a task observes this takes longer than all the rest of a start. So what was lowered is kept, too, under a
digest of all that it is made from: this package's sources, versions, settings, the processor, what it closes
over, and the shapes of what it is given. What has no digest is not kept.
"""

import hashlib
import os
import pickle
import platform
import re
import struct
import sys
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache, cached_property, partial
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, EllipsisType, FunctionType, MappingProxyType, MethodType
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import export
from jax.core import Tracer

from usarmjx.base import warp_functions
from usarmjx.base.compilation import PROGRAMS_FOLDER, processor
from usarmjx.base.errors import WriteError
from usarmjx.base.files import write_beside
from usarmjx.base.process import STARTED, cores

MUJOCO = cast("Any", mujoco)  # whose stubs lack what follows
OURS = "usarmjx"
KNOWN_PACKAGES = frozenset({OURS, "jax", "jaxlib", "mujoco", "numpy", "flax", *sys.stdlib_module_names})
"""Whose classes and functions are as their name and the version say; ours, as the sources of the package."""
PLAIN = (bool, int, float, complex, str, bytes, type(None), EllipsisType, np.dtype)


class FingerprintError(TypeError):
    """A value holds something that has no digest: a function or class of someone else's, for instance."""


def fingerprint(*values: object) -> str:
    """Return a digest of values: of their types and of all that they hold, to the last bit.

    Args:
        values: Numbers, texts, arrays, models of MuJoCo, functions and classes of `KNOWN_PACKAGES`, and
            collections, dataclasses and other objects of these. Cached properties are left out, as what
            they are made from is in it.

    Raises:
        FingerprintError: They hold something else.
    """
    return _Digests().of(values).hex()


def name_of(thing: object) -> str:
    """Return the full name of a class or function of `KNOWN_PACKAGES`.

    Raises:
        FingerprintError: It is someone else's, or has no name by which it could be found.
    """
    module, name = str(getattr(thing, "__module__", "")), str(getattr(thing, "__qualname__", ""))
    if module.partition(".")[0] not in KNOWN_PACKAGES or not name or "<" in name:
        raise FingerprintError(f"{module}.{name} is not known by its name")
    return f"{module}.{name}"


class _Digests:
    """Digests of objects, each worked out once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[bytes, object]] = {}  # the objects, too: else their numbers are reused

    def of(self, value: object) -> bytes:
        """Return the digest of a value."""
        known = self._known.get(id(value))
        if known is None:
            known = self._digest(value), value
            self._known[id(value)] = known
        return known[0]

    def _digest(self, value: object) -> bytes:
        found = hashlib.blake2b(name_of(type(value)).encode() + b"\0", digest_size=20)
        parts = _leaf_parts(value)
        for part in self._inner_parts(value) if parts is None else parts:
            found.update(struct.pack("<q", len(part)))
            found.update(part)
        return found.digest()

    def _inner_parts(self, value: Any) -> list[bytes]:  # noqa: ANN401 - anything
        """Return the digests of what tells a value from others of its type."""
        match value:
            case list() | tuple():
                return self._all(cast("Iterable[object]", value))
            case set() | frozenset():
                return sorted(self._all(cast("Iterable[object]", value)))
            case dict() | MappingProxyType():
                pairs = cast("Mapping[object, object]", value).items()
                return self._all(one for pair in pairs for one in pair)
            case partial():
                whole = cast("partial[Any]", value)
                return self._all((whole.func, whole.args, whole.keywords))
            case MethodType():
                return self._all((value.__func__, value.__self__))
            case _ if is_dataclass(value):
                return self._named({one.name: getattr(value, one.name) for one in fields(value)})
            case _:
                return self._named(_attributes(value))

    def _all(self, values: Iterable[object]) -> list[bytes]:
        return [self.of(one) for one in values]

    def _named(self, values: Mapping[str, object]) -> list[bytes]:
        return [part for name, inner in values.items() for part in (name.encode(), self.of(inner))]


def _attributes(value: object) -> dict[str, object]:
    """Return the attributes of an object of ours, but for cached properties."""
    # What is written in another language may hold more than it shows.
    if type(value).__module__.partition(".")[0] != OURS:
        raise FingerprintError(f"nothing tells one {type(value).__name__} from another")
    return {
        name: inner
        for name, inner in vars(value).items()
        if not isinstance(getattr(type(value), name, None), cached_property)
    }


def _leaf_parts(value: object) -> list[bytes] | None:
    """Return what tells a value from others of its type; None: it is made of other objects."""
    if isinstance(value, Enum):
        return [value.name.encode()]
    if isinstance(value, np.ndarray | np.generic):
        return _array_parts(np.asarray(cast("Any", value)))
    if isinstance(value, PLAIN):
        return [repr(cast("object", value)).encode()]
    if isinstance(value, jax.Array):
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        held = jax.random.key_data(value) if is_key else value
        return [f"{value.dtype} {jax.typeof(held).weak_type}".encode(), *_array_parts(np.asarray(held))]
    if isinstance(value, mujoco.MjModel):
        data = np.zeros(MUJOCO.mj_sizeModel(value), np.uint8)
        MUJOCO.mj_saveModel(value, None, data)
        return [data.tobytes()]
    if isinstance(value, type | FunctionType | BuiltinFunctionType):
        return [name_of(value).encode()]
    return None


def _array_parts(value: np.ndarray) -> list[bytes]:
    if value.dtype.hasobject:
        raise FingerprintError("an array of objects has no digest")
    return [repr((value.dtype.descr, value.shape)).encode(), np.ascontiguousarray(value).tobytes()]


T = TypeVar("T")
CLOCK_ERROR = 1.0
"""How far the times of files may be off [s]."""
PACKAGE = Path(__file__).parents[1]
DISTRIBUTIONS = ("jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "flax", "scipy", "ml_dtypes", "warp-lang")
"""Whose versions can change a program."""
VARIABLES = ("XLA_", "TF_", "NPROC")
"""How environment variables begin that can change a program; JAX's own are among its settings."""
NO_SETTINGS = ("jax_compilation_cache_dir",)
"""Of JAX's settings those that say where things are kept."""


class SourcesChangedError(Exception):
    """Sources were changed after the process started: nobody knows which ones it has read."""


def digest_of_sources(folder: Path, since: float) -> str:
    """Return a digest of all files of a package but what Python compiles of them.

    Args:
        folder: Of the package.
        since: When this process read the first of them [s since the epoch].

    Raises:
        SourcesChangedError: One was changed since.
    """
    found = hashlib.blake2b(digest_size=20)
    for path in sorted(_files(folder)):
        if path.stat().st_mtime > since:
            raise SourcesChangedError(f"{path} was changed while this process ran")
        content = path.read_bytes()
        found.update(f"{path.relative_to(folder)} {len(content)}\n".encode())
        found.update(content)
    return found.hexdigest()


def _files(folder: Path) -> Iterable[Path]:
    for where, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        yield from (Path(where) / name for name in names)


@cache
def _sources() -> str:
    return digest_of_sources(PACKAGE, STARTED - CLOCK_ERROR)


def conditions() -> dict[str, object]:
    """Return what beside sources and arguments can change a program, by name."""
    known = cast("dict[str, object]", jax.config.values)  # pyright: ignore[reportUnknownMemberType]
    settings = {name: getattr(jax.config, name, value) for name, value in sorted(known.items())}
    told = {name: text for name, text in sorted(os.environ.items()) if name.startswith(VARIABLES)}
    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in DISTRIBUTIONS}},
        "processor": (processor(), cores(), [(str(one), one.device_kind) for one in jax.devices()]),
        "settings": {name: repr(value) for name, value in settings.items() if name not in NO_SETTINGS},
        "environment": told,
    }


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "none"


def find_keeper(*made_from: object) -> "ProgramCache | None":
    """Return what keeps programs that close over some values; None: nothing is kept.

    That is so where `keep_compilations` has not been called, on several devices or on what is neither a CPU
    nor a GPU, where sources were changed since the process started, and where a value has no `fingerprint`.

    Args:
        made_from: All that is not an argument of the programs and not in this package's sources.
    """
    folder = os.environ.get(PROGRAMS_FOLDER)
    if not folder or jax.default_backend() not in ("cpu", "gpu") or jax.device_count() != 1:
        return None
    try:
        return ProgramCache(Path(folder), fingerprint(_sources(), conditions(), made_from))
    except (FingerprintError, SourcesChangedError, RecursionError, OSError):
        return None


def compile_program(
    function: Callable[..., Any],
    keeper: "ProgramCache | None",
    owner: str,
    *,
    static: tuple[int, ...] = (),
    precise: bool = True,
) -> Callable[..., Any]:
    """Return a function as `jax.jit` compiles it, kept if there is a keeper and no argument is static.

    Args:
        function: Of arrays.
        keeper: See `find_keeper`.
        owner: Whose function it is.
        static: Places of arguments that are no arrays.
        precise: Whether matrix products are in full single precision: TensorFloat-32 would cost a millimetre
            at room scale.
    """
    named = function
    while isinstance(named, partial):
        named = named.func
    exact = jax.default_matmul_precision("highest")(function) if precise else function
    compiled = jax.jit(exact, static_argnums=static)
    return compiled if keeper is None or static else keeper.keep(f"{owner}.{named.__name__}", compiled)


class ProgramCache:
    """Keeps programs, and what is known of them, in a folder.

    Args:
        folder: Where.
        digest: Of all that they are made from.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._digest = folder, digest
        self._names = set[str]()

    def keep(self, name: str, compiled: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of arrays that is read from a file where it was traced at an earlier start.

        Args:
            name: Of the function; the second of a name is not kept, as it may be another one.
            compiled: The function, as `jax.jit` returns it.
        """
        if name in self._names:
            return compiled
        self._names.add(name)
        return CachedProgram(self, name, compiled)

    def value(self, name: str, make: Callable[[], T]) -> T:
        """Return a value as it is made, or as it was made at an earlier start.

        Args:
            name: Of the value, which none of the others with this digest has.
            make: Makes it; it must be one that can be pickled.
        """
        path = self.path(name, "value")
        found = read_kept(path, pickle.loads)
        if found is None:
            found = make()
            write_kept(path, pickle.dumps(found))
        return found

    def of(self, *made_from: object) -> "ProgramCache | None":
        """Return a keeper of programs that close over more values; None: one has no `fingerprint`.

        Args:
            made_from: As for `find_keeper`, without what this one's programs are made from.
        """
        try:
            return ProgramCache(self._folder, fingerprint(self._digest, made_from))
        except (FingerprintError, RecursionError):
            return None

    def path(self, name: str, signature: str) -> Path:
        """Return the file of what is kept.

        Args:
            name: Of it.
            signature: What it is given, as text.
        """
        digest = hashlib.blake2b(f"{self._digest}\n{name}\n{signature}".encode(), digest_size=20)
        return self._folder / f"{name}-{digest.hexdigest()}"


class PrecompiledProgram:
    """A compiled function that can be compiled before there is anything to give it.

    Args:
        program: As `compile_program` returns it.
    """

    def __init__(self, program: Any) -> None:  # noqa: ANN401 - JAX's own, or a `CachedProgram`
        self._program, self._ready = program, None

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Return what the function returns."""
        if self._ready is not None:
            try:
                return self._ready(*args)
            except (TypeError, ValueError):  # of other shapes, or on another device, than was said
                self._ready = None
        return self._program(*args)

    def compile(self, *shapes: Any, tell: Callable[[Any], None] = lambda shapes: None) -> None:  # noqa: ANN401 - PyTrees
        """Compile it for arguments of such shapes, on their devices.

        Args:
            shapes: Of its arguments.
            tell: Is given the shapes of what it returns, as soon as they are known.
        """
        lowered = self._program.lower(*shapes)
        tell(lowered.out_info)
        self._ready = lowered.compile()


class CachedProgram:
    """A compiled function of arrays, read from a file where it was traced before.

    Args:
        keeper: Knows the file.
        name: Of the function.
        compiled: The function, as `jax.jit` returned it.
    """

    def __init__(self, keeper: ProgramCache, name: str, compiled: Any) -> None:  # noqa: ANN401 - JAX's own
        self._keeper, self._name, self._compiled = keeper, name, compiled
        self._programs: dict[Any, Callable[..., Any]] = {}

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Return what the function returns; within another one that is traced it is part of that."""
        leaves, tree = jax.tree.flatten(args)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._compiled(*args)
        return self._program(args, leaves, tree)(*args)

    def lower(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Return the program for arguments of such shapes as `jax.jit` lowers it, read if it was kept."""
        return self._program(args, *jax.tree.flatten(args)).lower(*args)

    def _program(self, args: tuple[Any, ...], leaves: list[Any], tree: Any) -> Any:  # noqa: ANN401 - as above
        """Return what `jax.jit` has made of the program for such arguments."""
        known = tree, *[_shape_of(leaf) for leaf in leaves]
        program = self._programs.get(known)
        if program is None:
            program = self._programs[known] = self._find(args, tree, known[1:])
        return program

    def _find(self, args: tuple[Any, ...], tree: Any, shapes: tuple[Any, ...]) -> Callable[..., Any]:  # noqa: ANN401
        """Return the program for such arguments: read, or traced and written."""
        try:
            signature = f"{shapes} {hashlib.blake2b(pickle.dumps(tree)).hexdigest()}"
        except (pickle.PicklingError, TypeError, AttributeError):
            return self._compiled  # of something that cannot be kept
        path = self._keeper.path(self._name, signature)
        exported = read_kept(path, _load)
        if exported is None:
            data = _traced(self._compiled, args)
            if data is None:
                return self._compiled
            write_kept(path, data)
            exported = _load(data)
        program = cast("Callable[..., Any]", exported.call)  # pyright: ignore[reportUnknownMemberType]
        return jax.jit(program)


def _traced(compiled: Any, args: tuple[Any, ...]) -> bytes | None:  # noqa: ANN401 - JAX's own
    """Return a program as it is kept; None: it cannot be, as it calls functions of this process, for one."""
    try:
        compiled.trace(*args)  # after which all kernels of Warp in it are known
        ours = [export.DisabledSafetyCheck.custom_call(target) for target in sorted(warp_functions.targets())]
        exported = export.export(compiled, disabled_checks=ours)(*args)
        text = str(exported.mlir_module()) if ours else ""
        numbers = [int(number) for number in LAUNCH.findall(text)]
        # JAX has a way to write it, which needs a package more and loses which types are weak.
        return pickle.dumps((replace(exported, _get_vjp=None), warp_functions.launches(numbers)))
    except Exception:  # whatever is wrong with the program itself is said when it is compiled
        return None


def _shape_of(leaf: Any) -> tuple[Any, ...]:  # noqa: ANN401 - an array or number
    """Return all of an argument that a program depends on."""
    found = leaf if isinstance(leaf, jax.ShapeDtypeStruct) else jax.typeof(leaf)
    return found.shape, found.dtype, getattr(found, "weak_type", False)


LAUNCH = re.compile(r"launch_id = (\d+)")
"""What Warp writes into programs."""


def _load(data: bytes) -> export.Exported:
    exported, launches = pickle.loads(data)
    warp_functions.expect(launches)
    return exported


def read_kept(path: Path, load: Callable[[bytes], T]) -> T | None:
    """Return what a file holds; None: it is not there, or broken: then that is warned of, and it goes."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    try:
        if _checksum(data[CHECKSUM:]) != data[:CHECKSUM]:
            raise ValueError("it is not whole")
        return load(zlib.decompress(data[CHECKSUM:]))
    except Exception as error:
        path.unlink(missing_ok=True)
        warnings.warn(f"Error reading the kept program {path.name}: {error}", stacklevel=2)
        return None


CHECKSUM = 20
"""Bytes of the digest that a file begins with."""


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=CHECKSUM).digest()


def write_kept(path: Path, data: bytes) -> None:
    """Write what is to be kept; what cannot be written is warned of and no failure."""
    data = zlib.compress(data, level=1)
    try:
        with write_beside(path) as fresh:
            fresh.write_bytes(_checksum(data) + data)
    except WriteError as error:
        warnings.warn(f"Error writing the kept program {path.name}: {error}", stacklevel=2)
