"""Confinement of a process in namespaces of its own (Linux).

A confined process sees only the files that a `View` names, no other process, and no network. What
it starts dies with it. The calls are those that bubblewrap makes: unshare, mount, pivot_root. No
privileges are needed where the system lets users make namespaces.

This file uses the standard library alone and can be run as a script, so that a program can be
confined before it starts:

    python -I -S confinement.py BYTES [PROGRAM ARGUMENT ...] < VIEW

BYTES limits each file that it writes; VIEW is a view as JSON, or null for a program that is not
confined: not an argument, since a program can read the command line. Without a program it ends at
once, with exit code 0 if the system allows confinement.
"""

import ctypes
import functools
import json
import os
import resource
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

# linux/sched.h: new namespaces of mounts, hosts' names, IPC, users, processes, network
_NAMESPACES = 0x00020000 | 0x04000000 | 0x08000000 | 0x10000000 | 0x20000000 | 0x40000000
_BIND, _RECURSIVE, _PRIVATE = 4096, 1 << 14, 1 << 18  # linux/mount.h
_DETACH = 2  # for umount2: immediately, in use or not
_PIVOT_ROOT = {"x86_64": 155, "aarch64": 41}
_MOUNT_SETATTR, _BELOW = 442, 0x8000
_DEATH_SIGNAL, _DROP_CAPABILITY, _NO_NEW_PRIVILEGES = 1, 24, 38  # for prctl
_CAPABILITIES = 0x20080522  # version 3 of linux/capability.h
_SYSTEM = [
    *map(Path, ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/etc", "/opt", "/nix")),
    # processors and graphics cards
    *map(Path, ("/sys/devices", "/sys/class", "/sys/bus", "/sys/module")),
]
_DEVICES = ("null", "zero", "full", "random", "urandom", "dri", "nvidia*")
_SCRATCH = (Path("/tmp"), Path("/dev/shm"))  # empty ones of its own
_ROOT = Path("/tmp")  # where the new root is built: any folder that is there


@dataclass(frozen=True)
class VisiblePaths:
    """Absolute paths that a confined process sees, besides those of the system.

    Attributes
    ----------
    readable : files and folders that it may read.
    changeable : folders that it may read; what it writes there is seen by itself only, and
        forgotten.
    writable : folders that it may read and write.
    hidden : folders and files among the others that are empty for it.
    home : its HOME, where its environment is made anew.
    """

    readable: tuple[str, ...] = ()
    changeable: tuple[str, ...] = ()
    writable: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    home: str = "/tmp"


@functools.cache
def can_confine() -> bool:
    """Check whether this system lets this user confine a process, by confining one."""
    if sys.platform != "linux" or os.uname().machine not in _PIVOT_ROOT:
        return False
    view = VisiblePaths(changeable=(str(Path(__file__).parent),))
    words, message = start_words((), 1 << 30), start_input(view)
    done = subprocess.run(words, input=message, stderr=subprocess.DEVNULL, check=False)
    return done.returncode == 0


def start_words(program: Sequence[str], file_bytes: int) -> list[str]:
    """Return the command that starts a program."""
    return [sys.executable, "-I", "-S", __file__, str(file_bytes), *program]


def start_input(view: VisiblePaths | None) -> bytes:
    """Return what that command reads: a view, or None for no confinement."""
    return json.dumps(None if view is None else asdict(view)).encode()


def confine(view: VisiblePaths) -> None:
    """Confine the calling process, which must have one thread.

    It goes on as the child of a child: the first process of the new namespace has to wait for all
    others there. The process that called waits as well, and ends as the confined one does.

    Raises OSError: the system refuses.
    """
    _unshare()
    receiver, sender = os.pipe()
    if first := os.fork():
        os.close(sender)
        _end_like_confined(first, receiver)
    die_with_parent()
    os.close(receiver)
    if confined := os.fork():
        _wait_for_all(confined, sender)
    die_with_parent()
    os.close(sender)
    _enter(view)
    _drop_privileges()


def die_with_parent() -> None:
    """Let the system kill this process when its parent dies."""
    _call("prctl", _DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)


def _drop_privileges() -> None:
    """Give up all capabilities, since these could undo mounts."""
    _call("prctl", _NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    for number in range(int(Path("/proc/sys/kernel/cap_last_cap").read_text()) + 1):
        _call("prctl", _DROP_CAPABILITY, number, 0, 0, 0)
    _call("capset", struct.pack("Ii", _CAPABILITIES, 0), bytes(24))


def _call(name: str, *arguments: object) -> None:
    if getattr(_libc(), name)(*arguments):
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")


@functools.cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _unshare() -> None:
    user, group = os.getuid(), os.getgid()
    _call("unshare", _NAMESPACES)
    proc = Path("/proc/self")
    (proc / "setgroups").write_text("deny", encoding="ascii")
    (proc / "uid_map").write_text(f"{user} {user} 1", encoding="ascii")
    (proc / "gid_map").write_text(f"{group} {group} 1", encoding="ascii")


def _wait_for_all(confined: int, sender: int) -> None:
    """Be the namespace's first process: when the confined one ends, so do all."""
    while True:
        pid, status = os.wait()
        if pid == confined:
            os.write(sender, struct.pack("i", status))
            os._exit(0)


def _end_like_confined(first: int, receiver: int) -> None:
    """Wait for the namespace's end, and end as the confined process did."""
    told = os.read(receiver, 4)
    os.waitpid(first, 0)
    code = os.waitstatus_to_exitcode(struct.unpack("i", told)[0]) if told else -signal.SIGKILL
    if code < 0:
        if -code not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(-code, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.kill(os.getpid(), -code)
    os._exit(code)


def _enter(view: VisiblePaths) -> None:
    links = {path: path.readlink() for path in _SYSTEM if path.is_symlink()}
    mounts = _mounts(view, links)
    sources = {path: os.open(path, os.O_PATH) for path in mounts if path.exists()}
    here = Path.cwd()
    _mount(None, Path("/"), None, _RECURSIVE | _PRIVATE)
    _mount_new("tmpfs", _ROOT)
    for path, target in links.items():
        _in_root(path).symlink_to(target)
    for path in _SCRATCH:
        _in_root(path).mkdir(parents=True)
        _mount_new("tmpfs", _in_root(path), "size=25%,mode=1777")
    for path in sorted(sources, key=lambda path: len(path.parts)):
        source = Path(f"/proc/self/fd/{sources[path]}")
        if mounts[path] is _hide and not _in_root(path).exists():
            continue
        _make_place(source, _in_root(path))
        mounts[path](source, _in_root(path))
    _in_root(Path("/proc")).mkdir()
    _mount_new("proc", _in_root(Path("/proc")))
    _make_read_only(_ROOT, below=False)
    for number in sources.values():
        os.close(number)
    _change_root(here)


def _mounts(
    view: VisiblePaths, links: Collection[Path]
) -> dict[Path, Callable[[Path, Path], None]]:
    """List what is mounted, and how; a later word on a path replaces an earlier one."""
    shown = [path for path in _SYSTEM if path not in links]
    devices = [path for name in _DEVICES for path in Path("/dev").glob(name)]
    hows: list[tuple[Iterable[Path | str], Callable[[Path, Path], None]]] = [
        ([*shown, *view.readable], _show),
        (view.changeable, _overlay),
        (view.hidden, _hide),
        ([*view.writable, *devices], _bind),
    ]
    return {Path(path): how for paths, how in hows for path in paths}


def _in_root(path: Path) -> Path:
    return _ROOT / path.relative_to("/")


def _make_place(source: Path, place: Path) -> None:
    """Make an empty folder or file to mount something on, unless it is there."""
    if source.is_dir():
        place.mkdir(parents=True, exist_ok=True)
    elif not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()


def _bind(source: Path, place: Path) -> None:
    _mount(source, place, None, _BIND | _RECURSIVE)


def _show(source: Path, place: Path) -> None:
    """Show a file or a folder and all that is mounted below it, to be read."""
    _bind(source, place)
    _make_read_only(place, below=True)


def _overlay(source: Path, place: Path) -> None:
    """Show a folder; what is written to it goes into memory."""
    layer = _ROOT / ".written" / source.name
    for name in ("upper", "work"):
        (layer / name).mkdir(parents=True)
    layers = f"lowerdir={source},upperdir={layer}/upper,workdir={layer}/work,userxattr"
    _mount_new("overlay", place, layers)


def _hide(source: Path, place: Path) -> None:
    """Cover a folder or a file by an empty one."""
    if source.is_dir():
        _mount_new("tmpfs", place)
    else:
        _mount("/dev/null", place, None, _BIND)


def _mount_new(kind: str, place: Path, options: str | None = None) -> None:
    """Mount a new file system; the flags of mount are those of statvfs."""
    _mount(kind, place, kind, os.ST_NOSUID | os.ST_NODEV, options)


def _mount(
    source: Path | str | None, place: Path, kind: str | None, flags: int, options: str | None = None
) -> None:
    words = [word and os.fsencode(word) for word in (source, place, kind)]
    _call("mount", *words, ctypes.c_ulong(flags), options and os.fsencode(options))


def _make_read_only(place: Path, *, below: bool) -> None:
    """Make a mount read-only, and those below it where `below` is true."""
    change = struct.pack("4Q", os.ST_RDONLY | os.ST_NOSUID, 0, 0, 0)
    # the first 0 would be the folder that a relative path starts from
    words = (0, os.fsencode(place), _BELOW if below else 0, change, len(change))
    _call("syscall", _MOUNT_SETATTR, *words)


def _change_root(here: Path) -> None:
    os.chdir(_ROOT)
    _call("syscall", _PIVOT_ROOT[os.uname().machine], b".", b".")
    _call("umount2", b".", _DETACH)
    os.chdir(here if here.is_dir() else "/")


def _main(file_bytes: str, *program: str) -> None:
    """Become a program: limits of files and cores, signals as a program expects them."""
    for number in (signal.SIGXFSZ, signal.SIGPIPE, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
    most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    limit = int(file_bytes) if most == resource.RLIM_INFINITY else min(int(file_bytes), most)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        die_with_parent()
    view = json.load(sys.stdin)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    if view is not None:
        confine(VisiblePaths(**view))
    if not program:
        return
    try:
        os.execv(program[0], program)
    except OSError as error:
        sys.exit(f"it cannot be started: {error.strerror}")


if __name__ == "__main__":
    _main(*sys.argv[1:])
