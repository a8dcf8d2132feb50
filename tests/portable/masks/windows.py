"""Windows: what its files, processes and sockets refuse, beside the names that `systems.py` hides.

Source of each refusal: the documentation of the function in the standard library. For open files it is that of
`CreateFile` (https://learn.microsoft.com/windows/win32/api/fileapi/nf-fileapi-createfilew): Python opens files without
FILE_SHARE_DELETE, so that nobody deletes or renames one while it is open. For names it is `os.path.isreserved` of
Python 3.13 and https://learn.microsoft.com/windows/win32/fileio/naming-a-file.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import signal
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.portable.masks.hiding import Call, Mask
from tests.portable.masks.systems import WINDOWS

CODE_PAGE = "cp1252"
"""What text without an encoding is written in."""

_RESERVED = re.compile(r"(CON|PRN|AUX|NUL|CONIN\$|CONOUT\$|(COM|LPT)[1-9¹²³]) *(\..*)?", re.IGNORECASE | re.DOTALL)
_NEVER = re.compile(r'[<>:"|?*\\\x00-\x1f]|[ .]$')


def _error(number: int, words: str, path: object) -> OSError:
    return OSError(number, words, os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else path)


def _check_name(path: Any) -> None:
    """Raise `OSError` if the last part of a path is no name of a file there, or would be changed in silence."""
    name = Path(os.fsdecode(path)).name
    if _RESERVED.fullmatch(name) or _NEVER.search(name):
        raise _error(errno.EINVAL, "The filename, directory name, or volume label syntax is incorrect", path)


def _open_files() -> Iterator[Path]:
    """Yield each file that this process has open."""
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            file = descriptor.readlink()
            if file.is_file():
                yield file


def _check_closed(path: Any) -> None:
    """Raise `PermissionError` if this process has a file open, or one in a folder."""
    named = Path(os.fsdecode(path))
    real = named.parent.resolve() / named.name
    if any(file.is_relative_to(real) for file in _open_files()):
        raise _error(errno.EACCES, "The process cannot access the file because it is being used by another", path)


def _rename(real: Call) -> Call:
    def rename(source: Any, target: Any) -> None:
        _check_name(target)
        _check_closed(source)
        if os.path.lexists(target):
            raise _error(errno.EEXIST, "Cannot create a file when that file already exists", target)
        real(source, target)

    return rename


def _replace(real: Call) -> Call:
    def replace(source: Any, target: Any) -> None:
        _check_name(target)
        _check_closed(source)
        if Path(target).is_dir():
            raise _error(errno.EACCES, "Access is denied", target)
        _check_closed(target)
        real(source, target)

    return replace


def _unlink(real: Call) -> Call:
    def unlink(path: Any) -> None:
        _check_closed(path)
        if Path(path).is_file() and not Path(path).stat().st_mode & stat.S_IWRITE:
            raise _error(errno.EACCES, "Access is denied", path)
        real(path)

    return unlink


def _chmod(real: Call) -> Call:
    def chmod(path: Any, mode: int, **options: Any) -> None:
        """Change the flag of a file that is read only, and nothing else."""
        before = Path(path).stat().st_mode
        real(path, before | 0o222 if mode & stat.S_IWRITE else before & ~0o222, **options)

    return chmod


def _mkdir(real: Call) -> Call:
    def mkdir(path: Any, *arguments: Any, **options: Any) -> None:
        _check_name(path)
        real(path, *arguments, **options)

    return mkdir


def _symlink(_real: Call) -> Call:
    def symlink(_source: Any, target: Any, *_arguments: Any, **_options: Any) -> None:
        raise _error(errno.EINVAL, "A required privilege is not held by the client", target)

    return symlink


def _fsync(real: Call) -> Call:
    def fsync(file: Any) -> None:
        descriptor = file if isinstance(file, int) else file.fileno()
        if fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        real(descriptor)

    return fsync


def _os_open(real: Call) -> Call:
    def opened(path: Any, flags: int, *arguments: Any, **options: Any) -> int:
        if Path(path).is_dir():
            raise _error(errno.EACCES, os.strerror(errno.EACCES), path)
        if flags & os.O_CREAT:
            _check_name(path)
        return int(real(path, flags, *arguments, **options))

    return opened


def _io_open(real: Call) -> Call:
    def opened(
        file: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Any = None,
    ) -> Any:
        if not isinstance(file, int):
            if Path(file).is_dir():
                raise _error(errno.EACCES, os.strerror(errno.EACCES), file)
            if set(mode) & set("wax"):
                _check_name(file)
        if "b" not in mode:
            encoding = CODE_PAGE if encoding in (None, "locale") else encoding
            newline = "\r\n" if newline is None and set(mode) & set("wax+") else newline
        return real(file, mode, buffering, encoding, errors, newline, closefd, opener)

    return opened


def _os(_mask: Mask, _real: Any) -> Mapping[str, object]:
    return {"name": "nt", "linesep": "\r\n", "kill": _kill}


def _kill(process: int, number: int) -> None:
    """End a process, whatever the signal is."""
    if process == os.getpid():
        os._exit(number)
    os.kill(process, signal.SIGKILL)


def _select(_mask: Mask, real: Any) -> Mapping[str, object]:
    def select(readers: Sequence[Any], writers: Sequence[Any], others: Sequence[Any], *timeout: float | None) -> Any:
        """Wait for sockets, and for nothing else."""
        ends = [*readers, *writers, *others]
        if not ends:
            raise OSError(errno.EINVAL, "An invalid argument was supplied")
        if not all(_is_socket(end) for end in ends):
            raise OSError(errno.ENOTSOCK, "An operation was attempted on something that is not a socket")
        return real.select(readers, writers, others, *timeout)

    return {"select": select}


def _is_socket(file: Any) -> bool:
    return stat.S_ISSOCK(os.fstat(file if isinstance(file, int) else file.fileno()).st_mode)


def _selectors(_mask: Mask, real: Any) -> Mapping[str, object]:
    return {"DefaultSelector": real.SelectSelector}


def _subprocess(mask: Mask, real: Any) -> Mapping[str, object]:
    def make_start(start: Call) -> Call:
        def started(process: Any, arguments: Any, **options: Any) -> None:
            if options.get("preexec_fn") is not None:
                raise ValueError("preexec_fn is not supported on Windows platforms")
            if options.get("pass_fds"):
                raise AssertionError("pass_fds not supported on Windows.")
            for stream in map(options.get, ("stdin", "stdout", "stderr")):
                if isinstance(stream, int) and stream >= 0 and _is_socket(stream):
                    raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            if options.get("text") or options.get("universal_newlines"):
                options["encoding"] = options.get("encoding") or CODE_PAGE
            start(process, arguments, **options)

        return started

    def make_signal(_real: Call) -> Call:
        def send_signal(process: Any, number: int) -> None:
            if number != signal.SIGTERM:
                raise ValueError(f"Unsupported signal: {number}")
            process.kill()

        return send_signal

    mask.substitute(real.Popen, "__init__", make_start)
    mask.substitute(real.Popen, "send_signal", make_signal)
    return {}


def _ctypes(_mask: Mask, real: Any) -> Mapping[str, object]:
    class CDLL(real.CDLL):  # type: ignore[misc]
        def __init__(self, name: str | None, *arguments: Any, **options: Any) -> None:
            if name is None:
                raise TypeError("argument 1 must be str, not None")
            super().__init__(name, *arguments, **options)

    return {"CDLL": CDLL}


def spawns(_mask: Mask, real: Any) -> Mapping[str, object]:
    """Have processes of `multiprocessing` begin anew where nothing else is asked for."""
    real.set_start_method("spawn", force=True)
    return {}


def _multiprocessing(mask: Mask, real: Any) -> Mapping[str, object]:
    def get_context(method: str | None = None) -> Any:
        if method not in (None, "spawn"):
            raise ValueError(f"cannot find context for {method!r}")
        return real.get_context("spawn")

    return {"get_context": get_context, "get_all_start_methods": lambda: ["spawn"], **spawns(mask, real)}


MASK = Mask(
    WINDOWS,
    functions={
        "io.open": _io_open,
        "os.chmod": _chmod,
        "os.fsync": _fsync,
        "os.mkdir": _mkdir,
        "os.open": _os_open,
        "os.remove": _unlink,
        "os.rename": _rename,
        "os.replace": _replace,
        "os.symlink": _symlink,
        "os.unlink": _unlink,
    },
    modules={
        "ctypes": _ctypes,
        "multiprocessing": _multiprocessing,
        "os": _os,
        "select": _select,
        "selectors": _selectors,
        "subprocess": _subprocess,
        "sys": lambda _mask, _real: {"platform": WINDOWS.platform},
    },
    # `rmtree` goes by paths, as it does where no function takes the descriptor of a folder.
    settings={"shutil._use_fd_functions": False},
)
