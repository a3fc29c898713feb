"""Compiled kernels, kept on disk until their source changes.

``@kernel`` compiles a function with numba at its first call and keeps the result, so that the
second start of a process compiles nothing.

numba's own cache looks only at the file of the function itself. A kernel that calls one of another
file would go on running the old one after a change there, silently. So each kernel gets a folder
of its own, named after a digest of all that went into it: its file, the kernels it calls, and the
constants it takes from its module.
"""

from __future__ import annotations

import builtins
import dis
import functools
import hashlib
import os
import shutil
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import config as numba_config
from numba.core import event as numba_event
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

from pwm_node import bits

Function = TypeVar("Function", bound=Callable[..., Any])

# Of a digest, in names
_DIGITS = 16

# Folders of earlier sources are kept a while: other checkouts on this machine may use them.
_KEEP_SECONDS = 7 * 24 * 3600

# Their functions are part of the compiler's version, not of our source.
_FOREIGN = {"numpy", "numba", "math", "cmath", "builtins", "operator"}

_LOAD_GLOBAL, _EXTENDED_ARG = dis.opmap["LOAD_GLOBAL"], dis.opmap["EXTENDED_ARG"]
# Since Python 3.11 the lowest bit of its argument is not part of the name's number.
_NAME_SHIFT = 1 if sys.version_info >= (3, 11) else 0


class KernelError(TypeError):
    """A function that cannot be made a kernel."""


def cache_folder() -> Path:
    """Return where compiled kernels are kept: ``$MFPCC_CACHE``, else ``~/.cache/mfpcc``."""
    chosen = os.environ.get("MFPCC_CACHE")
    if chosen:
        return Path(chosen).expanduser() / "kernels"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mfpcc" / "kernels"


def kernel(function: Function) -> Function:
    """Compile a function with numba, and keep the result on disk.

    Floating-point semantics are strict, so that a run is reproducible bit for bit; division by
    zero gives inf or nan, as in NumPy. The functions it calls must be defined above it or in
    modules imported above it.
    """
    return _compiled(function, forceinline=False)


def inlined(function: Function) -> Function:
    """A `kernel` that becomes part of those that call it.

    For small ones in an inner loop: their arguments and results stay in registers.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: Function, *, forceinline: bool) -> Function:
    digest = _digest(function)
    function.__kernel_digest__ = digest  # type: ignore[attr-defined]
    # numba names a compiled kernel by its qualified name and a number that counts within the
    # process which compiled it. So two of one name, as of one function made twice, may be called
    # the same where both come from disk. The digest tells them apart.
    function.__qualname__ += f"_{digest[:_DIGITS]}"
    compiled: Any = numba.njit(function, error_model="numpy", nogil=True, forceinline=forceinline)
    if compiled is function:  # numba is switched off
        return _plain(function)
    compiled._cache = _ToBeOpened(compiled, digest)
    if not forceinline:
        compiled.get_call_template = functools.partial(_called_by_value, compiled)
    return compiled  # type: ignore[no-any-return]


def _plain(function: Function) -> Function:
    """A kernel in Python, for those who want to step through it: NUMBA_DISABLE_JIT=1."""

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        return function(*map(_with_attributes, arguments))

    return call  # type: ignore[return-value]


class _Record(np.record):  # type: ignore[misc]
    """A record with its fields as attributes, whatever their names."""

    def __getattribute__(self, name: str) -> Any:
        field = (np.void.dtype.__get__(self).fields or {}).get(name)
        if field is None:
            return super().__getattribute__(name)
        return _with_attributes(self.getfield(*field[:2]))


def _with_attributes(value: Any) -> Any:
    """A record, or an array of such, with fields as attributes; anything else as it is."""
    if isinstance(value, (np.ndarray, np.void)):
        dtype = value.dtype
        if dtype.names is not None and dtype.type is not _Record:
            return value.view(np.dtype((_Record, dtype)))
    return value


def _called_by_value(
    kernel: Any, arguments: tuple[Any, ...], named: dict[str, Any]
) -> tuple[Any, Any, Any, Any]:
    """What numba asks for where one kernel calls another, without constants as types of their own.

    numba would compile a kernel once more for `0` or `False`, even for what a variable only holds
    before a loop. What is inlined has the constants anyhow.
    """
    arguments = tuple(numba.types.unliteral(argument) for argument in arguments)
    named = {name: numba.types.unliteral(argument) for name, argument in named.items()}
    template: tuple[Any, Any, Any, Any] = type(kernel).get_call_template(kernel, arguments, named)
    return template


class _ToBeOpened:
    """Where a kernel is kept, opened when numba first asks for it.

    Most kernels only become a part of others, and are not asked for where those come from disk. To
    open all of their folders would be a tenth of the start of a process.
    """

    def __init__(self, kernel: Any, digest: str) -> None:
        self._kernel = kernel
        self._digest = digest

    def __getattr__(self, name: str) -> Any:
        kernel = self._kernel
        folder = _folder(kernel.py_func, self._digest)
        if folder is None:
            kernel._cache = NullCache()
        else:
            # This setting says where the cache of a function is at the moment it is opened.
            before = numba_config.CACHE_DIR
            numba_config.CACHE_DIR = str(folder)
            try:
                kernel.enable_caching()
            finally:
                numba_config.CACHE_DIR = before
        return getattr(kernel._cache, name)


def direct(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Return a compiled kernel for arguments of exactly these types, to be called many times.

    Where a kernel itself is called, numba looks at the type of every argument first. In a loop that
    does much else this takes some microseconds, more than the work of a PWM period. Here nothing is
    looked at: what it is called with must be of the same types as `arguments`, and as writable.

    Parameters
    ----------
    function : callable
        A kernel.
    *arguments : object
        Examples of its arguments; it is compiled, not called.
    """
    if not isinstance(function, Dispatcher):
        return function  # where numba is switched off
    signature = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(signature)
    return function.overloads[signature].entry_point  # type: ignore[no-any-return]


def announce(say: Callable[[str], None] | None = None) -> None:
    """Say once when kernels have to be compiled, since it takes a while.

    Parameters
    ----------
    say : callable, optional
        Gets the sentence; without it, it goes to the standard error stream. Nothing is said where
        all kernels come from disk.
    """
    numba_event.register("numba:compile", _Announcer(say or _say_on_stderr))


class _Announcer(numba_event.Listener):  # type: ignore[misc]
    _announced = False

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def on_start(self, event: Any) -> None:
        if not _Announcer._announced:
            _Announcer._announced = True
            self._say("compiling kernels (first start only) ...")

    def on_end(self, event: Any) -> None:
        pass


def _say_on_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


@functools.cache
def _say_once(text: str) -> None:
    """Say on stderr what is the same for each of many kernels."""
    _say_on_stderr(text)


def _folder(function: Callable[..., Any], digest: str) -> Path | None:
    """Return the cache folder of a kernel, or None where nothing can be kept."""
    if _source(function.__code__.co_filename) is None:
        return None  # typed at a prompt
    qualified = function.__qualname__.removesuffix(f"_{digest[:_DIGITS]}")
    name = f"{function.__module__}.{qualified}".replace("<locals>", "_")
    folder = cache_folder() / f"{name}-{digest[:_DIGITS]}"
    try:
        fresh = not _touched(folder)
        if fresh:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _say_once(
            f"compiled kernels cannot be kept in {folder.parent} ({error.strerror}), so each start "
            "compiles anew; set MFPCC_CACHE to a folder that can be written"
        )
        return None
    if fresh:
        _prune(folder.parent, name)
    return folder


def _touched(folder: Path) -> bool:
    """Note that a folder is in use; False if there is none."""
    try:
        os.utime(folder)
    except FileNotFoundError:
        return False
    return True


@functools.cache
def _source(path: str) -> bytes | None:
    """Content of a file of kernels, which has many of them; None if there is no such file."""
    try:
        return Path(path).read_bytes()
    except OSError:
        return None


def _prune(parent: Path, name: str) -> None:
    """Remove what was compiled from earlier sources of a kernel and not used for a while."""
    oldest = time.time() - _KEEP_SECONDS
    for folder in parent.glob(f"{name}-*"):
        try:
            if folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue  # another process was faster


def _digest(function: Callable[..., Any]) -> str:
    """Return a digest of a function's file, of what it calls, and of the constants it uses."""
    known = getattr(function, "__kernel_digest__", None)
    if known is not None:
        return str(known)
    parts = hashlib.sha256(
        f"named by digest {numba.__version__} {np.__version__} {sys.version_info[:2]}".encode()
    )
    parts.update(_source(function.__code__.co_filename) or function.__code__.co_code)
    for name, value in sorted(_references(function), key=lambda item: item[0]):
        parts.update(_frozen(name, value, function))
    return parts.hexdigest()


def _frozen(name: str, value: Any, user: Callable[..., Any]) -> bytes:
    """Return what a function uses under this name, as far as the compiler puts it into the code."""
    if isinstance(value, Dispatcher):
        value = value.py_func
    if isinstance(value, types.FunctionType):
        if value is user or value.__module__.split(".")[0] in _FOREIGN:
            return b""
        return f"{name}={_digest(value)}\n".encode()
    if isinstance(value, np.ndarray):
        return f"{name}={value.dtype}{value.shape}\n".encode() + bits.of(value)
    if isinstance(value, tuple):
        return b"".join(_frozen(f"{name}[{n}]", item, user) for n, item in enumerate(value))
    if isinstance(value, (bool, int, float, complex, str, bytes, np.generic, np.dtype)):
        return f"{name}={value!r}\n".encode()
    return b""


def _references(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Yield the names that a function takes from outside, with their values."""
    code = function.__code__
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        yield name, cell.cell_contents
    for name in _global_names(code):
        if name in function.__globals__:
            value = function.__globals__[name]
        elif hasattr(builtins, name) or name == function.__name__:
            continue
        else:
            # Its source could not be part of the digest.
            raise KernelError(
                f"kernel '{function.__name__}' in {code.co_filename} uses '{name}', which is not "
                "defined above it"
            )
        if not isinstance(value, types.ModuleType):
            yield name, value
        elif value.__name__.split(".")[0] not in _FOREIGN:
            for attribute in code.co_names:
                if hasattr(value, attribute):
                    yield f"{name}.{attribute}", getattr(value, attribute)


def _global_names(code: types.CodeType) -> set[str]:
    """Return the names that a function loads from its module.

    `dis` would say the same, and take a tenth of the start of a process for it.
    """
    found = set()
    extended = 0
    for operation, low in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument = extended | low
        extended = argument << 8 if operation == _EXTENDED_ARG else 0
        if operation == _LOAD_GLOBAL:
            found.add(code.co_names[argument >> _NAME_SHIFT])
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            found |= _global_names(constant)
    return found
