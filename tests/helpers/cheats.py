"""Tricks by which a solver might learn or change what is not its own. Each is the body of a
function that returns what it got, and may raise. `DATA` is the data set's folder, `SECRET` a file
next to it, `MARK` a path that must not come to be, `PORT` a listening server's, `SEEN` the
observation side that the solver was given, `TOKEN` a word in the environment of the process that
started it."""

import re

TRICKS = {
    "read the truth": "return open(DATA + '/truth.h5', 'rb').read(8)",
    "read the seed": "return open(DATA + '/manifest.json').read()",
    "read the scene": "return open(DATA + '/scene.toml').read()",
    "read the radiance": "return open(DATA + '/images/frame_0000/camera_00.exr', 'rb').read(8)",
    "read the secret": "return open(SECRET).read()",
    "look around": """
names = os.listdir(os.path.dirname(DATA))
return [name for name in names if name in ('set', 'secret.toml')] or None
""",
    "look next to the images": """
for folder, _, names in os.walk(os.path.dirname(SEEN)):
    found = [name for name in names if name in ('truth.h5', 'scene.toml') or name.endswith('.exr')]
    if found:
        return found
""",
    "read command lines": "return open(f'/proc/{PARENT}/cmdline', 'rb').read()",
    "read environments": """
for name in os.listdir('/proc'):
    if name.isdigit() and TOKEN.encode() in open(f'/proc/{name}/environ', 'rb').read():
        return name
""",
    "read open files": """
for name in os.listdir('/proc/self/fd'):
    place = os.readlink(f'/proc/self/fd/{name}')
    if DATA in place or os.path.isdir(place) and int(name) > 2 and place != '/proc':
        if not place.endswith('/fd'):
            return place
""",
    "walk objects": """
for one in gc.get_objects():
    if type(one).__name__ == 'Dataset' and getattr(one, 'has_truth', False):
        return one
frame = sys._getframe()
while frame:
    for value in list(frame.f_locals.values()):
        if isinstance(value, str) and value == DATA or str(value) == DATA:
            if frame.f_code.co_name not in ('trick', '<module>'):
                return value
    frame = frame.f_back
""",
    "ask the loader": """
if CASE is None:
    return None
return CASE.load.data.particles(0)
""",
    "write outside": "open(MARK, 'w').write('x')",
    "write to the data set": "return open(DATA + '/cameras.json', 'r+b').write(b'x')",
    "write to what was given": "return open(SEEN + '/cameras.json', 'r+b').write(b'x')",
    "remove what was given": "os.unlink(SEEN + '/images/frame_0000/camera_00.tif'); return 'gone'",
    "connect": "return socket.create_connection(('127.0.0.1', PORT), 2.0)",
    "outlive": """
subprocess.Popen(['setsid', 'env', '-i', '/bin/sleep', '4321'], start_new_session=True)
time.sleep(0.3)
""",
    "change sabench": """
import sabench
open(os.path.join(os.path.dirname(sabench.__file__), 'planted.py'), 'w').write('x')
""",
    "leave shared memory": "open('/dev/shm/planted', 'w').write('x')",
    "leave a file in /tmp": "open('/tmp/planted', 'w').write('x')",
    "make mounts writable": """
libc = ctypes.CDLL(None, use_errno=True)
if libc.mount(None, b'/usr', None, ctypes.c_ulong(4096 | 32), None) == 0:
    return 'writable'
if libc.umount2(b'/usr', 2) == 0:
    return 'unmounted'
""",
    "enter another namespace": """
libc = ctypes.CDLL(None, use_errno=True)
if libc.unshare(0x10000000 | 0x20000) == 0:
    for flags in (4096 | 32, 32):
        if libc.mount(None, b'/usr', None, ctypes.c_ulong(flags), None) == 0:
            open('/usr/planted', 'w').write('x')
            return 'writable'
""",
    "signal others": """
for number in range(2, 70000):
    if number != os.getpid():
        try:
            text = open(f'/proc/{number}/cmdline').read()
        except OSError:
            continue
        if 'pytest' in text:
            return os.kill(number, 0) or number
""",
    "trace others": """
libc = ctypes.CDLL(None, use_errno=True)
if libc.ptrace(16, PARENT, 0, 0) == 0:
    libc.ptrace(17, PARENT, 0, 0)
    return 'traced'
""",
}

_HEAD = """
import ctypes, gc, os, socket, subprocess, sys, time

DATA, SECRET, MARK, PORT, TOKEN, PARENT = {constants!r}

{functions}

def gains(case, seen):
    gained = []
    for number, trick in enumerate([{names}]):
        try:
            if trick(case, seen) is not None:
                gained.append(str(number))
        except Exception:
            pass
    return " ".join(gained)
"""
_PLUGIN = '''"""Cheats."""

import numpy as np

from sabench.api import {imports}
{head}

class Cheat({base}):
    """Tries all tricks, and finds nothing."""

    name = "cheat"

    def solve(self, case: {case}):
        frame = sys._getframe()
        while "data" not in frame.f_locals or not hasattr(frame.f_locals["data"], "root"):
            frame = frame.f_back
        gained = gains(case, str(frame.f_locals["data"].root))
        raise RuntimeError(f"gained [{{gained}}]")
'''
_PROGRAM = """#!{python}
{head}
sys.exit(f"gained [{{gains(None, sys.argv[1])}}]")
"""


def _head(constants: tuple[object, ...]) -> str:
    functions = []
    for number, body in enumerate(TRICKS.values()):
        lines = "\n".join(f"    {line}" for line in body.strip().splitlines())
        functions.append(f"def trick_{number}(CASE, SEEN):\n{lines}\n")
    names = ", ".join(f"trick_{number}" for number in range(len(TRICKS)))
    return _HEAD.format(constants=constants, functions="\n".join(functions), names=names)


def plugin(kind: str, constants: tuple[object, ...]) -> str:
    case, base = {
        "reconstruction": ("Observation", "Solver"),
        "particles": ("ImageSequence", "ParticleSolver"),
    }[kind]
    return _PLUGIN.format(imports=f"{case}, {base}", head=_head(constants), base=base, case=case)


def program(constants: tuple[object, ...], python: str) -> str:
    return _PROGRAM.format(python=python, head=_head(constants))


def gained(message: str) -> list[str]:
    """List the tricks that gained something, by the message of the solver's failure."""
    found = re.search(r"gained \[([0-9 ]*)\]", message)
    assert found, message
    return [list(TRICKS)[int(number)] for number in found[1].split()]
