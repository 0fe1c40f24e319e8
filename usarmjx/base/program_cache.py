"""Cache of traced and lowered programs, so that the next start traces nothing.

JAX caches what XLA compiles under a digest of the lowered program, which requires tracing and lowering; for a
task's observation function these take longer than the rest of a start. This cache stores lowered programs
under a digest of their ingredients: this package's sources, versions, settings, the processor, the
closed-over values, and the shapes of the arguments. A program whose ingredients have no digest is not cached.
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
from concurrent.futures import Executor, Future
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache, cached_property, lru_cache, partial
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
from usarmjx.base.backend import single_precision
from usarmjx.base.checked_cache import LoadingEntries, discard, read_sealed, write_sealed
from usarmjx.base.compilation import PROGRAMS_FOLDER, processor
from usarmjx.base.errors import WriteError
from usarmjx.base.process import PROCESS_START, cores

MUJOCO = cast("Any", mujoco)
"""The module untyped: its stubs lack `mj_sizeModel` and the saving of a model."""
OWN_PACKAGE = "usarmjx"
"""Name of this package."""
KNOWN_PACKAGES = frozenset(
    {OWN_PACKAGE, "jax", "jaxlib", "mujoco", "numpy", "flax", *sys.stdlib_module_names}
)
"""Packages whose classes and functions are identified by name and version; our own by the sources' digest."""
PLAIN_TYPES = (bool, int, float, complex, str, bytes, type(None), EllipsisType, np.dtype)
"""Types whose repr identifies a value."""
SCALARS = frozenset({bool, int, float, str, type(None)})
"""Those of which a scene has most, but none of their subclasses."""
T = TypeVar("T")
CLOCK_ERROR = 1.0
"""Tolerance of file times [s]."""
PACKAGE = Path(__file__).parents[1]
"""Folder of this package."""
DISTRIBUTIONS = ("jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "flax", "scipy", "ml_dtypes", "warp-lang")
"""Distributions whose versions can change a program."""
VARIABLES = ("XLA_", "TF_", "NPROC")
"""Prefixes of environment variables that can change a program; JAX's own are among its settings."""
IGNORED_SETTINGS = ("jax_compilation_cache_dir",)
"""JAX settings that cannot change a program."""
LAUNCH_ID = re.compile(r"launch_id = (\d+)")
"""Launch id in the text of a program with Warp kernels."""


class FingerprintError(TypeError):
    """Value that has no digest: a function or class of an unknown package, for instance."""


def fingerprint(*values: object) -> str:
    """Return a digest of values: their types and their whole content, to the last bit.

    Args:
        values: Numbers, texts, arrays, MuJoCo models, functions and classes of `KNOWN_PACKAGES`, and
            collections, dataclasses and other objects of these. Cached properties are left out because they
            follow from the rest.

    Raises:
        FingerprintError: They contain something else.
    """
    return _Digests().of(values).hex()


def name_of(thing: object) -> str:
    """Return the full name of a class or function of `KNOWN_PACKAGES`.

    Raises:
        FingerprintError: It is from another package, or cannot be found by a name (a lambda, a local
            function).
    """
    module, name = str(getattr(thing, "__module__", "")), str(getattr(thing, "__qualname__", ""))
    if module.partition(".")[0] not in KNOWN_PACKAGES or not name or "<" in name:
        raise FingerprintError(f"{module}.{name} is not known by its name")
    return f"{module}.{name}"


def _digest_of(kind: type, parts: Iterable[bytes]) -> bytes:
    """Return the digest of what distinguishes a value from others of its type."""
    # The type is part of it: 1, 1.0 and True are equal but trace to different programs.
    found = hashlib.blake2b(_type_bytes(kind), digest_size=20)
    for part in parts:
        # Lengths keep ("ab", "c") apart from ("a", "bc").
        found.update(struct.pack("<q", len(part)))
        found.update(part)
    return found.digest()


@cache
def _type_bytes(kind: type) -> bytes:
    return name_of(kind).encode() + b"\0"


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(one.name for one in fields(kind))


@lru_cache(maxsize=65536)
def _digest_of_scalar(kind: type, text: str) -> bytes:
    # Scenes repeat few numbers many thousand times.
    return _digest_of(kind, [text.encode()])


class _Digests:
    """Memoised digests of objects."""

    def __init__(self) -> None:
        self._known: dict[
            int, tuple[bytes, object]
        ] = {}  # holds the objects, too: the id of a freed one is reused

    def of(self, value: object) -> bytes:
        """Return the digest of a value."""
        if type(value) in SCALARS:
            # By text, not by value: 0.0 and -0.0 are equal.
            return _digest_of_scalar(type(value), repr(value))
        known = self._known.get(id(value))
        if known is None:
            known = self._digest(value), value
            self._known[id(value)] = known
        return known[0]

    def _digest(self, value: object) -> bytes:
        parts = _leaf_parts(value)
        return _digest_of(type(value), self._inner_parts(value) if parts is None else parts)

    def _inner_parts(self, value: Any) -> list[bytes]:  # noqa: ANN401 - anything
        """Return the digests that distinguish a value from others of its type."""
        match value:
            case list() | tuple():
                return self._all(cast("Iterable[object]", value))
            case set() | frozenset():
                # A set of texts is iterated in another order in every process.
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
                return self._named({name: getattr(value, name) for name in _field_names(type(value))})
            case _:
                return self._named(_attributes(value))

    def _all(self, values: Iterable[object]) -> list[bytes]:
        return [self.of(one) for one in values]

    def _named(self, values: Mapping[str, object]) -> list[bytes]:
        return [part for name, inner in values.items() for part in (name.encode(), self.of(inner))]


def _attributes(value: object) -> dict[str, object]:
    """Return the attributes of an object of this package, without cached properties."""
    # An object of an extension type may hold state that `vars` does not show.
    if type(value).__module__.partition(".")[0] != OWN_PACKAGE:
        raise FingerprintError(f"nothing tells one {type(value).__name__} from another")
    return {
        name: inner
        for name, inner in vars(value).items()
        if not isinstance(getattr(type(value), name, None), cached_property)
    }


def _leaf_parts(value: object) -> list[bytes] | None:
    """Return the bytes that distinguish a value from others of its type; None: it contains other objects."""
    if isinstance(value, Enum):
        return [value.name.encode()]
    if isinstance(value, np.ndarray | np.generic):
        return _array_parts(np.asarray(cast("Any", value)))
    if isinstance(value, PLAIN_TYPES):
        return [repr(cast("object", value)).encode()]
    if isinstance(value, jax.Array):
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        # Typed keys cannot become NumPy arrays.
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
    # Shape and type belong to it: the same bytes may be (2, 3) or (3, 2).
    return [repr((value.dtype.descr, value.shape)).encode(), np.ascontiguousarray(value).tobytes()]


class SourcesChangedError(Exception):
    """Sources changed after the process started: it is unknown which version was imported."""


def digest_of_sources(folder: Path, since: float) -> str:
    """Return a digest of all files of a package except byte code.

    Args:
        folder: Folder of the package.
        since: Time at which this process read the first file [s since the epoch].

    Raises:
        SourcesChangedError: A file changed since.
    """
    found = hashlib.blake2b(digest_size=20)
    # Sorted: the order of directory entries differs between file systems.
    for path in sorted(_files(folder)):
        # Python has imported the older version: a digest of the newer one would describe other programs.
        if path.stat().st_mtime > since:
            raise SourcesChangedError(f"{path} was changed while this process ran")
        content = path.read_bytes()
        found.update(f"{path.relative_to(folder)} {len(content)}\n".encode())
        found.update(content)
    return found.hexdigest()


def _files(folder: Path) -> Iterable[Path]:
    for where, folders, names in os.walk(folder):
        # In place: `os.walk` descends into what is left in this list.
        folders[:] = [name for name in folders if name != "__pycache__"]
        yield from (Path(where) / name for name in names)


@cache
def _sources() -> str:
    # File times may lag behind the clock: a file written just after the start could look older.
    return digest_of_sources(PACKAGE, PROCESS_START - CLOCK_ERROR)


def build_conditions() -> dict[str, object]:
    """Return what can change a program besides sources and arguments, by name."""
    known = cast("dict[str, object]", jax.config.values)  # pyright: ignore[reportUnknownMemberType]
    # `values` holds what is set globally; the attribute also shows what a context manager has set here.
    settings = {name: getattr(jax.config, name, value) for name, value in sorted(known.items())}
    environment = {name: text for name, text in sorted(os.environ.items()) if name.startswith(VARIABLES)}
    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in DISTRIBUTIONS}},
        "processor": (processor(), cores(), [(str(one), one.device_kind) for one in jax.devices()]),
        "settings": {name: repr(value) for name, value in settings.items() if name not in IGNORED_SETTINGS},
        "environment": environment,
    }


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "none"


def open_program_cache(*ingredients: object) -> "ProgramCache | None":
    """Return the cache of programs that close over some values; None: nothing is cached.

    There is no cache before `enable_compilation_cache`, with several devices or one that is neither a CPU nor
    a GPU, after a change of sources since the process started, and if a value has no `fingerprint`.

    Args:
        ingredients: All ingredients that are neither arguments of the programs nor sources of this package.
    """
    folder = os.environ.get(PROGRAMS_FOLDER)
    if not folder or jax.default_backend() not in ("cpu", "gpu") or jax.device_count() != 1:
        return None
    try:
        return ProgramCache(Path(folder), fingerprint(_sources(), build_conditions(), ingredients))
    except (FingerprintError, SourcesChangedError, RecursionError, OSError):
        return None


def compile_program(
    function: Callable[..., Any],
    program_cache: "ProgramCache | None",
    owner: str,
    *,
    static: tuple[int, ...] = (),
    precise: bool = True,
) -> Callable[..., Any]:
    """Compile a function as `jax.jit` does, cached if there is a cache and no argument is static.

    Args:
        function: Function of arrays.
        program_cache: See `open_program_cache`.
        owner: Prefix of the function's name in the cache.
        static: Positions of the static arguments.
        precise: Whether matrix products are in full single precision: TensorFloat-32 would cost a millimetre
            at room scale.
    """
    named = function
    while isinstance(named, partial):
        named = named.func
    # `named` keeps the function's own name for the cache: the wrapper and partials have none.
    exact = jax.default_matmul_precision("highest")(function) if precise else function
    # Outermost, so that it holds while the function is traced, whenever that happens.
    exact = single_precision(exact)
    # Exported programs have no static arguments: such a function is compiled anew by each process.
    compiled = jax.jit(exact, static_argnums=static)
    return (
        compiled
        if program_cache is None or static
        else program_cache.keep(f"{owner}.{named.__name__}", compiled)
    )


class ProgramCache:
    """Folder of programs, and of values computed for them.

    Args:
        folder: The folder.
        digest: Digest of all ingredients.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._digest = folder, digest
        self._names = set[str]()

    def keep(self, name: str, compiled: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of arrays that is read from a file if an earlier process traced it.

        Args:
            name: Name of the function. A second function of that name is not cached: it may be another one.
            compiled: Result of `jax.jit`.
        """
        if name in self._names:
            return compiled
        # Closures of one name could hold different values, which the name does not show.
        self._names.add(name)
        return CachedProgram(self, name, compiled)

    def value(self, name: str, make: Callable[[], T]) -> T:
        """Return a value, computed now or read from an earlier process's file.

        Args:
            name: Name of the value, unique within this cache.
            make: Computes it; the value must support pickling.
        """
        path = self.path(name, "value")
        found = read_entry(path, pickle.loads)
        if found is None:
            found = make()
            write_entry(path, pickle.dumps(found))
        return found

    def of(self, *ingredients: object) -> "ProgramCache | None":
        """Return a cache of programs that close over more values; None: one has no `fingerprint`.

        Args:
            ingredients: As for `open_program_cache`, in addition to the ingredients of this cache.
        """
        try:
            return ProgramCache(self._folder, fingerprint(self._digest, ingredients))
        except (FingerprintError, RecursionError):
            return None

    def path(self, name: str, signature: str) -> Path:
        """Return the file of an entry.

        Args:
            name: Name of the entry.
            signature: Text that identifies the arguments' shapes.
        """
        digest = hashlib.blake2b(f"{self._digest}\n{name}\n{signature}".encode(), digest_size=20)
        return self._folder / f"{name}-{digest.hexdigest()}"


class PrecompiledProgram:
    """Compiled function that can be compiled before its arguments exist.

    Args:
        program: Result of `compile_program`.
    """

    def __init__(self, program: Any) -> None:  # noqa: ANN401 - JAX's own, or a `CachedProgram`
        self._program, self._ready = program, None
        self._pending: Future[Any] | None = None

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Call the function."""
        if self._pending is not None:
            # An error of the compilation appears here, at the first call, and not in the thread.
            self._ready, self._pending = self._pending.result(), None
        if self._ready is not None:
            try:
                return self._ready(*args)
            except (TypeError, ValueError):  # other shapes, or another device, than compiled for
                self._ready = None
        return self._program(*args)

    def compile(self, *shapes: Any, tell: Callable[[Any], None] = lambda shapes: None) -> None:  # noqa: ANN401 - PyTrees
        """Compile for arguments of the given shapes, on their devices.

        Args:
            shapes: Shapes of the arguments.
            tell: Takes the shapes of the results as soon as they are known.
        """
        lowered = self._program.lower(*shapes)
        tell(lowered.out_info)
        self._ready = lowered.compile()

    def compile_in(self, pool: Executor, *shapes: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Trace now, compile in another thread, for which the first call waits.

        Args:
            pool: Threads.
            shapes: Shapes of the arguments, or arguments.

        Returns:
            Shapes of the results.
        """
        lowered = self._program.lower(*shapes)
        self._pending = pool.submit(lowered.compile)
        return lowered.out_info


class CachedProgram:
    """Compiled function of arrays that is read from a file if it was traced before.

    Args:
        program_cache: The cache.
        name: Name of the function.
        compiled: Result of `jax.jit`.
    """

    def __init__(self, program_cache: ProgramCache, name: str, compiled: Any) -> None:  # noqa: ANN401 - JAX's own
        self._program_cache, self._name, self._compiled = program_cache, name, compiled
        self._programs: dict[Any, Callable[..., Any]] = {}

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Call the function; while another function is being traced, become part of that one."""
        leaves, tree = jax.tree.flatten(args)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            # An exported program has no rule for `vmap`, under which the outer function may be traced.
            return self._compiled(*args)
        return self._program(args, leaves, tree)(*args)

    def lower(self, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
        """Return the lowered program for arguments of such shapes, read from a file if possible."""
        return self._program(args, *jax.tree.flatten(args)).lower(*args)

    def _program(self, args: tuple[Any, ...], leaves: list[Any], tree: Any) -> Any:  # noqa: ANN401 - as above
        """Return the `jax.jit` program for such arguments."""
        # The same ingredients as those of `jax.jit`'s own cache: a wrong hit would run another shape's
        # program.
        known = tree, *[_shape_of(leaf) for leaf in leaves]
        program = self._programs.get(known)
        if program is None:
            program = self._programs[known] = self._find(args, tree, known[1:])
        return program

    def _find(self, args: tuple[Any, ...], tree: Any, shapes: tuple[Any, ...]) -> Callable[..., Any]:  # noqa: ANN401
        """Return the program for such arguments: read from a file, or traced and written."""
        try:
            signature = f"{shapes} {hashlib.blake2b(pickle.dumps(tree)).hexdigest()}"
        except (pickle.PicklingError, TypeError, AttributeError):
            return self._compiled  # an argument tree that cannot be pickled has no signature
        path = self._program_cache.path(self._name, signature)
        exported = read_entry(path, _load)
        if exported is None:
            data = _traced(self._compiled, args)
            if data is None:
                return self._compiled
            write_entry(path, data)
            exported = _load(data)
        program = cast("Callable[..., Any]", exported.call)  # pyright: ignore[reportUnknownMemberType]
        # `exported.call` alone would be traced at each call.
        return jax.jit(program)


def _traced(compiled: Any, args: tuple[Any, ...]) -> bytes | None:  # noqa: ANN401 - JAX's own
    """Return the bytes of a traced program; None: it cannot be exported, for instance with host callbacks."""
    try:
        compiled.trace(*args)  # afterwards `warp_functions` knows all Warp kernels in it
        # JAX exports unknown custom calls only on request; ours are registered anew by each process.
        ours = [export.DisabledSafetyCheck.custom_call(target) for target in sorted(warp_functions.targets())]
        exported = export.export(compiled, disabled_checks=ours)(*args)
        text = str(exported.mlir_module()) if ours else ""
        numbers = [int(number) for number in LAUNCH_ID.findall(text)]
        # Exported.serialize needs flatbuffers and loses weak types.
        return pickle.dumps((replace(exported, _get_vjp=None), warp_functions.launches(numbers)))
    except Exception:  # an error of the program itself appears when it is compiled
        return None


def _shape_of(leaf: Any) -> tuple[Any, ...]:  # noqa: ANN401 - an array or number
    """Return everything about an argument on which a program depends."""
    found = leaf if isinstance(leaf, jax.ShapeDtypeStruct) else jax.typeof(leaf)
    return found.shape, found.dtype, getattr(found, "weak_type", False)


def _load(data: bytes) -> export.Exported:
    exported, launches = pickle.loads(data)
    # Kernels must be registered before the program that calls them is compiled.
    warp_functions.expect(launches)
    return exported


def read_entry(path: Path, load: Callable[[bytes], T]) -> T | None:
    """Return the content of an entry; None: missing, or broken, which warns and removes the file."""
    data = read_sealed(path, path.name)
    if data is None:
        return None
    try:
        with _loading_entries(path.parent).loading(path):
            # A broken program may crash the process instead of raising: the note lets the next start remove
            # it.
            return load(zlib.decompress(data))
    except Exception as error:
        discard(path, str(error))
        return None


@cache
def _loading_entries(folder: Path) -> LoadingEntries:
    return LoadingEntries(folder)


def write_entry(path: Path, data: bytes) -> None:
    """Write an entry; a write error is only a warning."""
    try:
        write_sealed(path, zlib.compress(data, level=1), path.name)
    except WriteError as error:
        warnings.warn(f"Error writing the kept program {path.name}: {error}", stacklevel=2)
