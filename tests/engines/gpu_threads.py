"""Native code for a GPU run here: threads of the machine are its threads, and wait for each other as they do.

A compiler of C++20 makes a library of it, in which what a GPU has of its own (threads of a block, warps that
vote and exchange numbers) is made of barriers. It shows what the code computes, not how fast.
"""

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COMPILER = shutil.which("g++") or shutil.which("clang++")

GPU = r"""
#include <algorithm>
#include <barrier>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>
namespace wp {
inline float abs(float x) { return std::fabs(x); }
inline float cos(float x) { return std::cos(x); }
inline float exp(float x) { return std::exp(x); }
inline float sin(float x) { return std::sin(x); }
inline float sqrt(float x) { return std::sqrt(x); }
template <class T> T min(T a, T b) { return a < b ? a : b; }
template <class T> T max(T a, T b) { return a > b ? a : b; }
template <class T> struct array_t { T* data; int shape[1]; int strides[1]; };  // of its first dimension
}
#define __CUDA_ARCH__ 900
#define __shared__ static
struct Place { unsigned x; };
thread_local Place threadIdx;
static std::unique_ptr<std::barrier<>> block;
static std::map<std::pair<int, unsigned>, std::unique_ptr<std::barrier<>>> groups;  // of a warp
static std::mutex making;
static unsigned members[32];
static uint64_t told[32][32];
static int one_said;
int warp() { return threadIdx.x / 32; }
int lane() { return threadIdx.x % 32; }
void __syncthreads() { block->arrive_and_wait(); }
int __syncthreads_or(int x) {
    if (threadIdx.x == 0) one_said = 0;
    __syncthreads();
    if (x) __atomic_store_n(&one_said, 1, __ATOMIC_SEQ_CST);
    __syncthreads();
    const int found = one_said;
    __syncthreads();
    return found;
}
void __syncwarp(unsigned mask = 0xffffffffu) {
    mask &= members[warp()];
    std::barrier<>* group;
    {
        const std::lock_guard<std::mutex> only(making);
        auto& known = groups[{warp(), mask}];
        if (!known) known = std::make_unique<std::barrier<>>(__builtin_popcount(mask));
        group = known.get();
    }
    group->arrive_and_wait();
}
unsigned __activemask() { return members[warp()]; }
template <class T> T __shfl_sync(unsigned mask, T value, int from) {
    std::memcpy(&told[warp()][lane()], &value, sizeof(T));
    __syncwarp(mask);
    std::memcpy(&value, &told[warp()][from], sizeof(T));
    __syncwarp(mask);
    return value;
}
template <class T> T __shfl_xor_sync(unsigned mask, T value, int step) {
    return __shfl_sync(mask, value, lane() ^ step);
}
unsigned __ballot_sync(unsigned mask, bool x) {
    told[warp()][lane()] = x;
    __syncwarp(mask);
    unsigned found = 0u;
    for (int i = 0; i < 32; ++i)
        if ((mask & members[warp()]) >> i & 1u && told[warp()][i]) found |= 1u << i;
    __syncwarp(mask);
    return found;
}
unsigned __match_any_sync(unsigned mask, int x) {
    told[warp()][lane()] = (uint64_t)x;
    __syncwarp(mask);
    unsigned found = 0u;
    for (int i = 0; i < 32; ++i)
        if ((mask & members[warp()]) >> i & 1u && told[warp()][i] == (uint64_t)x) found |= 1u << i;
    __syncwarp(mask);
    return found;
}
int __any_sync(unsigned mask, bool x) { return __ballot_sync(mask, x) != 0u; }
int atomicMin(int* at, int value) {
    const std::lock_guard<std::mutex> only(making);
    const int old = *at;
    *at = std::min(old, value);
    return old;
}
int atomicMax(int* at, int value) {
    const std::lock_guard<std::mutex> only(making);
    const int old = *at;
    *at = std::max(old, value);
    return old;
}
int atomicAdd(int* at, int value) {
    const std::lock_guard<std::mutex> only(making);
    const int old = *at;
    *at += value;
    return old;
}
int __popc(unsigned x) { return __builtin_popcount(x); }
int __ffs(int x) { return __builtin_ffs(x); }
"""

RUN = """
static void kernel(PARAMETERS) {CODE}
extern "C" void run(GIVEN, int dim) {
    for (int begin = 0; begin < dim; begin += BLOCK) {
        const int size = std::min(BLOCK, dim - begin);
        block = std::make_unique<std::barrier<>>(size);
        groups.clear();
        for (int first = 0; first < size; first += 32) {
            const int count = std::min(32, size - first);
            members[first / 32] = count == 32 ? 0xffffffffu : (1u << count) - 1u;
        }
        std::vector<std::thread> all;
        for (int i = 0; i < size; ++i)
            all.emplace_back([=] { threadIdx.x = i; const int index = begin + i; kernel(CALL); });
        for (auto& one : all) one.join();
    }
}
"""


FLAGS = ("-O1", "-std=c++20", "-shared", "-fPIC", "-pthread", "-w")


@cache
def _compiler() -> str:
    found = subprocess.run([str(COMPILER), "--version"], check=True, capture_output=True, text=True)
    return found.stdout


def _kept(suffix: str, words: tuple[str, ...], compile_to: Callable[[Path], None]) -> Path:
    """Return a compiled file, which is kept beside the programs of JAX: compiling takes seconds.

    Args:
        suffix: Of its name.
        words: All that it depends on, but for the version of Warp.
        compile_to: Writes the file.
    """
    folder = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
    key = "\n".join((metadata.version("warp-lang"), *words))
    file = folder / f"gpu-threads-{hashlib.sha256(key.encode()).hexdigest()}{suffix}"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        compile_to(part)
        part.replace(file)  # another process reads all of it or nothing
    return file


@cache
def _library(source: str, more: tuple[str, ...] = ()) -> Any:
    """Return the entry of a library."""

    def compile_to(file: Path) -> None:
        with tempfile.TemporaryDirectory() as own:
            code = Path(own) / "gpu.cpp"
            code.write_text(source, encoding="utf-8")
            subprocess.run([str(COMPILER), *FLAGS, *more, str(code), "-o", str(file)], check=True)

    return ctypes.CDLL(str(_kept(".so", (_compiler(), *FLAGS, *more, source), compile_to))).run


def run_as_on_a_gpu(code: str, kernel: Any, args: list[Any], dim: int, block: int) -> list[np.ndarray]:
    """Return the kernel's arrays after a launch.

    Args:
        code: Native code of the function that the kernel calls, which knows its thread as `index`.
        kernel: Warp's; its parameters are told by it.
        args: Its arguments, arrays flat; what is output of it besides.
        dim: Threads.
        block: Threads of a block.
    """
    parameters, given, call, values = ["const int index"], [], ["index"], []
    arrays = [np.array(arg) for arg in args if isinstance(arg, np.ndarray)]
    rest = iter(arrays)
    for known, arg in zip(kernel.adj.args, args, strict=True):
        is_array = isinstance(arg, np.ndarray)
        kind = "float" if (arg.dtype == np.float32 if is_array else isinstance(arg, float)) else "int"
        name = known.label
        parameters.append(f"wp::array_t<{kind}> {name}" if is_array else f"const {kind} {name}")
        given.append(f"{kind}* {name}" if is_array else f"{kind} {name}")
        call.append(f"{{{name}}}" if is_array else name)
        if is_array:
            values.append(next(rest).ctypes.data_as(ctypes.c_void_p))
        else:
            values.append(ctypes.c_float(arg) if kind == "float" else ctypes.c_int(arg))
    words = {"PARAMETERS": parameters, "GIVEN": given, "CALL": call}
    source = RUN.replace("BLOCK", str(block))
    for word, them in words.items():
        source = source.replace(word, ", ".join(them))
    _library(GPU + source.replace("{CODE}", "{" + code + "}"))(*values, dim)
    return arrays


def run_struct_as_on_a_gpu(
    code: str, fields: dict[str, np.ndarray | int], dim: int, block: int, **numbers: int
) -> None:
    """Run native code whose data are the struct `p`; what it writes is in its arrays then.

    Args:
        code: Native code of the function that the kernel calls, which knows its thread as `index`.
        fields: Arrays, contiguous, and integers of the struct.
        dim: Threads.
        block: Threads of a block.
        numbers: Its other arguments.
    """
    arrays = {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}
    whole = {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}
    kinds = {name: "float" if value.dtype == np.float32 else "int" for name, value in arrays.items()}
    begin = [f"wp::array_t<{kind}> {name};" for name, kind in kinds.items()]
    begin = ["struct {", *begin, *(f"int {name};" for name in whole), "} p;"]
    for i, (name, kind) in enumerate(kinds.items()):
        first = len(whole) + 2 * i
        begin.append(f"p.{name} = {{({kind}*)arrays[{i}], {{numbers[{first}]}}, {{numbers[{first + 1}]}}}};")
    begin += [f"p.{name} = numbers[{i}];" for i, name in enumerate(whole)]
    words = {
        "PARAMETERS": [
            "const int index",
            "void** arrays",
            "int* numbers",
            *(f"const int {name}" for name in numbers),
        ],
        "GIVEN": ["void** arrays", "int* numbers", *(f"int own_{name}" for name in numbers)],
        "CALL": ["index", "arrays", "numbers", *(f"own_{name}" for name in numbers)],
    }
    source = RUN.replace("BLOCK", str(block))
    for word, them in words.items():
        source = source.replace(word, ", ".join(them))
    run = _library(GPU + source.replace("{CODE}", "{" + " ".join(begin) + code + "}"))
    pointers = (ctypes.c_void_p * len(arrays))(*(value.ctypes.data for value in arrays.values()))
    sizes = [size for value in arrays.values() for size in (len(value), value.strides[0])]
    integers = (ctypes.c_int * (len(whole) + len(sizes)))(*whole.values(), *sizes)
    run(pointers, integers, *map(ctypes.c_int, numbers.values()), dim)


WARPS = """
struct Dim3 { unsigned x, y, z; };
thread_local Dim3 blockIdx;
static Dim3 gridDim{1, 1, 1}, blockDim{1, 1, 1};
inline float4 __ldg(const float4* at) { return *at; }
template <class T> T __reduce_min_sync(unsigned mask, T x) {
    for (int step = 16; step > 0; step >>= 1) {
        const T other = __shfl_xor_sync(mask, x, step);
        x = other < x ? other : x;
    }
    return x;
}
"""

WARP_RUN = """
extern "C" void run(void** arrays, int* numbers, int dim) {
    wp_args_NAME args{};
    FILL
    wp::launch_bounds_t<1> bounds{};
    bounds.shape[0] = bounds.size = dim;
    blockDim.x = BLOCK;
    for (int begin = 0; begin < dim; begin += BLOCK) {
        block = std::make_unique<std::barrier<>>(BLOCK);
        groups.clear();
        for (int warp = 0; warp < BLOCK / 32; ++warp) members[warp] = 0xffffffffu;
        std::vector<std::thread> all;
        for (int i = 0; i < BLOCK; ++i)
            all.emplace_back([=, &args] {
                threadIdx.x = i;
                blockIdx = {unsigned(begin / BLOCK), 0, 0};
                auto mine = args;
                NAME_cpu_kernel_forward(bounds, begin + i, &mine);
            });
        for (auto& one : all) one.join();
    }
}
"""


def run_kernel_as_on_a_gpu(
    kernel: Any, args: list[Any], outputs: list[np.ndarray], dim: int, block: int
) -> list[np.ndarray]:
    """Return the outputs of a kernel in Warp's Python, whose native functions see a GPU.

    Args:
        kernel: Warp's; it is compiled with its module.
        args: Its arguments before the outputs: contiguous arrays, and integers.
        outputs: Arrays that it writes.
        dim: Threads, a multiple of `block`.
        block: Threads of a block.
    """
    import warp as wp

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        # Only its source is of use, and compiling that takes seconds.
        patch.setattr("warp._src.build.build_cpu", lambda *_, **__: None)
        # The code for a CPU is that for a GPU, but for what `__CUDA_ARCH__` says in native functions.
        wp.compile_aot_module(kernel.module, device="cpu", module_dir=folder)
        (path,) = Path(folder).glob("*.cpp")
        text = path.read_text(encoding="utf-8")
    heads, gpu = GPU[: GPU.index("namespace wp")], GPU[GPU.index("#define __CUDA_ARCH__") :]
    last = '#include "deterministic.h"'
    text = heads + text.replace("#define WP_NO_CRT", "").replace(last, last + gpu + WARPS)
    found = re.search(rf"void ({kernel.key}_\w+)_cpu_kernel_forward", text)
    assert found is not None
    name = found.group(1)
    values, numbers, arrays, fill = [*args, *outputs], [], [], []
    for known, value in zip(kernel.adj.args, values, strict=True):
        field = f"args.{known.label}"
        if isinstance(value, np.ndarray):
            fill.append(f"{field}.data = (decltype({field}.data))arrays[{len(arrays)}];")
            shape = f"{field}.ndim = 1; {field}.shape[0] = {value.size};"
            fill.append(f"{shape} {field}.strides[0] = sizeof(*{field}.data);")
            arrays.append(value.ctypes.data)
        else:
            fill.append(f"{field} = numbers[{len(numbers)}];")
            numbers.append(int(value))
    run = WARP_RUN.replace("NAME", name).replace("FILL", " ".join(fill)).replace("BLOCK", str(block))
    native = Path(wp.__file__).parent / "native"
    flags = (f"-I{native}", "-Wl,--defsym=wp_cpu_run_block=0")
    pointers = (ctypes.c_void_p * len(arrays))(*arrays)
    _library(text + run, flags)(pointers, (ctypes.c_int * len(numbers))(*numbers), dim)
    return outputs


def ptx_of(module: Any, folder: Path, arch: int = 75) -> str:
    """Return what NVRTC, which comes with Warp and needs no GPU, compiles of a module of kernels.

    Args:
        module: Warp's, or the Python module that has the kernels.
        folder: Empty folder.
        arch: Compute capability, 75 for 7.5.
    """
    import warp as wp
    from warp._src import build

    compile_source = build.build_cuda

    def build_once(source: str, arch: int, output: str, *, pch_dir: Any, **options: Any) -> None:
        def compile_to(file: Path) -> None:
            compile_source(source, arch, output, pch_dir=pch_dir, **options)
            shutil.copyfile(output, file)

        words = Path(source).read_text(encoding="utf-8"), str(arch), repr(sorted(options.items()))
        shutil.copyfile(_kept(".ptx", words, compile_to), output)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "build_cuda", build_once)
        # With the optimisation that users have: it decides which memory a kernel needs.
        patch.setattr(wp.config, "optimization_level", None)
        wp.compile_aot_module(module, arch=arch, module_dir=folder, use_ptx=True)
    (path,) = folder.glob("*.ptx")
    return path.read_bytes().decode("latin-1")
