"""Seeded random changes to bytes, trees of values, HDF5 files and archives."""

import contextlib
import copy
import io
import math
import random
import struct
import tarfile
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tifffile

NUMBERS: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 7, 0.5, 1e-12, 1e-300, 1e6, 1e9, 1e15, 1e300, -1e300, 1.7e308),
    *(float("nan"), float("inf"), -float("inf"), 255, 65536, 10**6, 10**9, 2**31),
    *(2**63 - 1, 2**63, 2**64, -(2**63), 10**40, True, False),
)
TEXTS = (
    *("", " ", "x", "../../evil", "/etc/passwd", "a\x00b", "\u202eevil", "x" * 5000),
    *("[red]", "<script>", "ä€😀", "1", "nan", "quick", "\ud800", "-", "%n"),
)


def tree(value: Any, rng: random.Random) -> Any:
    made = copy.deepcopy(value)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        made = _changed(made, rng)
    return made


def _changed(root: Any, rng: random.Random) -> Any:
    places = [place for place in _places(root) if place]
    if not places or rng.random() < 0.01:
        return odd(rng)
    *path, last = rng.choice(places)
    parent = root
    for part in path:
        parent = parent[part]
    how = rng.random()
    if how < 0.12:
        del parent[last]
    elif how < 0.2 and isinstance(parent, dict):
        parent[_typo(str(last), rng)] = parent.pop(last)
    elif how < 0.3 and isinstance(parent, list):
        parent.insert(last, copy.deepcopy(rng.choice(parent)))
    elif how < 0.36:
        parent[last] = copy.deepcopy(_at(root, rng.choice(places)))
    else:
        parent[last] = _other(parent[last], rng)
    return root


def _places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner: Any = value.items() if isinstance(value, dict) else ()
    inner = enumerate(value) if isinstance(value, list) else inner
    return [at, *(place for key, part in inner for place in _places(part, (*at, key)))]


def _at(root: Any, place: tuple[Any, ...]) -> Any:
    for part in place:
        root = root[part]
    return root


def _other(value: Any, rng: random.Random) -> Any:
    if rng.random() < 0.25:
        return odd(rng)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        if rng.random() < 0.5:
            return rng.choice(NUMBERS)
        factor = rng.choice((0, -1, 2, 0.5, 1e-9, 1e-3, 1000, 10**6, 10**12))
        return value * factor + rng.choice((0, 0, 1, -1, 0.5))
    if isinstance(value, str):
        return rng.choice(TEXTS) if rng.random() < 0.5 else _typo(value, rng)
    if isinstance(value, list):
        many = value * 2000 if len(value) < 10 else value
        return rng.choice(([], value[::-1], value * 2, value[:-1], many, [value]))
    return {} if isinstance(value, dict) else odd(rng)


def odd(rng: random.Random) -> Any:
    deep: Any = 1
    for _ in range(rng.choice((3, 3, 200))):
        deep = [deep]
    others: Any = (None, [], {}, deep, {"a": {"b": 1}}, [1, "x", None], list(range(1000)))
    return rng.choice((*NUMBERS, *TEXTS, *others))


def _typo(text: str, rng: random.Random) -> str:
    at = rng.randrange(len(text) + 1)
    other = rng.choice(("", "x", "\n", ".", "é", '"', "_", "0"))
    return text[:at] + other + text[at + rng.randrange(2) :]


def data(whole: bytes, rng: random.Random, head: int = 4096) -> bytes:
    """Change one to eight bytes, half of them near the beginning, where headers are."""
    made = bytearray(whole)
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        if not made:
            break
        at = rng.randrange(min(head, len(made)) if rng.random() < 0.5 else len(made))
        how = rng.random()
        if how < 0.4:
            made[at] ^= 1 << rng.randrange(8)
        elif how < 0.55:
            word = (0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x80000000, 65535, rng.randrange(2**32))
            made[at : at + 4] = struct.pack("<I", rng.choice(word))
        elif how < 0.65:
            long = (0, 2**63, 2**64 - 1, 2**40, rng.randrange(len(made)))
            made[at : at + 8] = struct.pack("<Q", rng.choice(long))
        elif how < 0.75:
            made[at:at] = rng.randbytes(rng.randrange(1, 40))
        elif how < 0.85:
            del made[at : at + rng.randrange(1, 40)]
        elif how < 0.93:
            other = rng.randrange(len(made))
            made[at : at + 16] = made[other : other + 16]
        else:
            del made[rng.randrange(len(made)) :]
    return bytes(made)


Change = Callable[[Any, str, random.Random], None]


def _no_data(file: Any, name: str, _: random.Random) -> None:
    del file[name]


def _other_shape(file: Any, name: str, rng: random.Random) -> None:
    old, shape = file[name], list(file[name].shape)
    del file[name]
    if rng.random() < 0.5 and shape:
        shape[rng.randrange(len(shape))] = rng.choice((0, 1, 2, 5, 17))
    else:
        shape = [rng.choice((0, 1, 2, 3)) for _ in range(rng.randrange(6))]
    fill = None if old.dtype.kind in "OSUV" else 1
    file.create_dataset(name, shape, old.dtype, fillvalue=fill)


def _other_type(file: Any, name: str, rng: random.Random) -> None:
    old = file[name]
    shape = old.shape
    del file[name]
    kinds: tuple[Any, ...] = (
        *("i1", "u1", "i4", "u8", "f2", "f4", "f8", ">f4", ">i2", "c8", "S3", "g"),
        *(h5py.string_dtype(), h5py.enum_dtype({"a": 1}), h5py.ref_dtype),
        *(np.dtype([("x", "f4"), ("y", "i2")]), np.dtype(("f4", (2,)))),
        *(h5py.vlen_dtype(np.float32), np.bool_),
    )
    file.create_dataset(name, shape, dtype=rng.choice(kinds))


def _bomb(file: Any, name: str, rng: random.Random) -> None:
    rank = len(file[name].shape)
    last = file[name].shape[-1] if rank > 1 else 10**9
    del file[name]
    shape = (rng.choice((10**6, 10**8, 10**10)), *(3,) * (rank - 2), last)[: max(rank, 1)]
    chunks = tuple(min(n, 1000) for n in shape)
    file.create_dataset(name, shape, "f8", chunks=chunks, compression="gzip")


def _large_chunk(file: Any, name: str, rng: random.Random) -> None:
    shape = file[name].shape
    dtype = file[name].dtype
    if not shape or 0 in shape:
        return
    del file[name]
    chunk = tuple(rng.choice((n, 2000, 20_000)) for n in shape)
    if np.prod(chunk, dtype=float) * dtype.itemsize > 4e9:
        chunk = (300_000_000, *(1 for _ in shape[1:]))
    file.create_dataset(name, shape, dtype, chunks=chunk, maxshape=(None,) * len(shape))


def _long_stream(file: Any, name: str, rng: random.Random) -> None:
    """A deflate stream that does not hold one chunk."""
    node = file[name]
    if not node.shape or 0 in node.shape or node.dtype.kind not in "iuf":
        return
    shape, dtype = node.shape, node.dtype
    del file[name]
    made = file.create_dataset(name, shape, dtype, chunks=shape, compression="gzip")
    size = rng.choice((0, 1, made.nbytes - 1, made.nbytes + 1, 10**6, 10**8, 10**8))
    stream = zlib.compress(bytes(size), 9)
    if rng.random() < 0.2:
        stream = data(stream[:100_000], rng) or b"x"
    made.id.write_direct_chunk((0,) * len(shape), stream)


def _odd_filter(file: Any, name: str, rng: random.Random) -> None:
    node = file[name]
    if not node.shape or 0 in node.shape or node.dtype.kind not in "iuf":
        return
    values = node[...]
    del file[name]
    kinds: tuple[dict[str, Any], ...] = (
        {"compression": "lzf"},
        {"fletcher32": True},
        {"shuffle": True, "compression": "gzip"},
        {"shuffle": True},
        {"scaleoffset": 3},
    )
    file.create_dataset(name, data=values, chunks=values.shape, **rng.choice(kinds))


def _blind(file: Any, name: str, rng: random.Random) -> None:
    """All data sets of one name get one value, as where no camera sees anything."""
    last = name.rpartition("/")[2]
    value = rng.choice((0, 0, float("nan"), -1))

    def change(other: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or not _is_small(node):
            return
        if other.rpartition("/")[2] == last and node.shape and node.dtype.kind in "iuf":
            same = value if node.dtype.kind == "f" else 0
            node[...] = np.full(node.shape, same, node.dtype)  # a single value: row by row, minutes

    file.visititems(change)


def _odd_values(file: Any, name: str, rng: random.Random) -> None:
    node = file[name]
    if node.dtype.kind not in "iuf" or not node.size:
        return
    values = node[...].reshape(-1)
    chosen: tuple[Any, ...] = (np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-40, 1e30, -1e30)
    chosen = (*chosen, 1e9, 3e38)
    if values.dtype.kind in "iu":
        ends = np.iinfo(values.dtype)
        chosen = (0, 1, ends.min, ends.max, -1 if values.dtype.kind == "i" else 1)
    if rng.random() < 0.3:
        values[:] = rng.choice(chosen)
    else:
        for _ in range(rng.choice((1, 3, 20))):
            values[rng.randrange(len(values))] = rng.choice(chosen)
    node[...] = values.reshape(node.shape)


def _a_link(file: Any, name: str, rng: random.Random) -> None:
    del file[name]
    soft = [h5py.SoftLink(one) for one in ("/", "/nowhere", f"/{name}")]
    outside = [("/etc/passwd", "/x"), (file.filename, f"/{name}")]
    file[name] = rng.choice((*soft, *(h5py.ExternalLink(*one) for one in outside)))


def _a_group(file: Any, name: str, rng: random.Random) -> None:
    del file[name]
    file.create_group(name)
    if rng.random() < 0.5:
        file[name]["loop"] = file["/"]


def _virtual(file: Any, name: str, rng: random.Random) -> None:
    shape, dtype = file[name].shape, file[name].dtype
    if not shape or dtype.kind not in "iuf":
        return
    del file[name]
    if rng.random() < 0.5:
        source = h5py.VirtualSource("/etc/hostname", "x", shape=shape)
        layout = h5py.VirtualLayout(shape=shape, dtype=dtype)
        layout[...] = source
        file.create_virtual_dataset(name, layout)
    else:
        file.create_dataset(name, shape, dtype, external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)])


def _odd_attribute(file: Any, _: str, rng: random.Random) -> None:
    names = [*file.attrs, "parameters", "seconds", "solver", "task"]
    name = rng.choice(names)
    made: tuple[Any, ...] = (
        *("", "x" * 70_000, "\x00", b"\xff\xfe", 0, -1, 1.5, float("nan"), float("inf"), 2**63),
        *(np.zeros(3), np.zeros((1, 1)), np.array([1]), [b"a", b"b"], h5py.Empty("f4")),
        *(np.bool_(True), np.complex64(1), "[1, 2]", '{"a": NaN}', '{"a": 1e999}', "[" * 3000),
        *('{"k": {"k": [1, null]}}', "calibration", "velocimetry", "bubbles", "see_through"),
        *("particles", np.str_("reconstruction").encode(), np.void(b"xx"), file.ref),
        *('"\\ud800"', "no JSON"),
    )
    file.attrs.pop(name, None)
    if rng.random() < 0.9:
        value = rng.choice(made)
        odd_text = isinstance(value, str) and "\x00" in value
        file.attrs.create(name, np.bytes_(value) if odd_text else value)


def _new_attribute(file: Any, _: str, rng: random.Random) -> None:
    file.attrs[rng.choice(("x", "y" * 100, "ä"))] = rng.choice((np.zeros(1000), "text", 5))


_CHANGES: tuple[Change, ...] = (
    *(_no_data, _other_shape, _other_type, _bomb, _large_chunk, _long_stream, _odd_filter),
    *(_blind, _odd_values, _odd_values, _odd_values, _a_link, _a_group, _virtual),
    *(_odd_attribute, _odd_attribute, _new_attribute),
)


def tiff(path: Path, rng: random.Random) -> None:
    shapes = ((24, 32), (24, 32), (32, 24), (24, 32, 3), (2, 24, 32), (1, 1), (3000, 3000))
    image = np.full(rng.choice(shapes), rng.choice((0, 64, 4095, 65535)))
    image = image.astype(rng.choice(("u2", "u2", "u1", "f4", "i2")))
    compression = rng.choice((None, None, "zlib"))
    predictor = compression is not None and image.dtype.kind in "iu" and rng.random() < 0.5
    tifffile.imwrite(
        path,
        image,
        compression=compression,
        predictor=predictor or None,
        tile=(16, 16) if rng.random() < 0.2 else None,
        photometric=rng.choice(("minisblack", "minisblack", "miniswhite")),
        bigtiff=rng.random() < 0.5,
        byteorder=rng.choice("<>"),
    )


def exr(path: Path, rng: random.Random) -> None:
    import OpenEXR

    shape = rng.choice(((24, 32), (24, 32), (24, 32), (32, 24), (1, 1), (2000, 2000)))
    image = np.full(shape, 1.0, dtype=rng.choice(("f4", "f4", "f4", "f2", "u4")))
    if image.dtype.kind == "f" and rng.random() < 0.5:
        values = (np.nan, np.inf, -np.inf, -1.0, -0.0, 6e4)
        image[0, : rng.randrange(1, shape[1] + 1)] = rng.choice(values)
    kinds = (OpenEXR.ZIP_COMPRESSION, OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION)
    head = {"compression": rng.choice(kinds), "type": OpenEXR.scanlineimage}
    names = rng.choice((("Y",), ("Y",), ("Y", "Z"), ("R",)))
    parts = [OpenEXR.Part(dict(head), dict.fromkeys(names, image), "a")]
    if rng.random() < 0.2:
        parts.append(OpenEXR.Part(dict(head), {"Y": image}, "b"))
    path.unlink()
    with OpenEXR.File(parts) as file:
        file.write(str(path))


def set_attribute(path: Path, name: str, value: Any) -> None:
    with contextlib.suppress(OSError, RuntimeError, KeyError), h5py.File(path, "r+") as file:
        file.attrs[name] = value


def _is_small(node: Any) -> bool:
    """Say whether a data set can be changed: the first change may have made a bomb of it. One value
    written to a chunk of gigabytes writes all of the chunk, and a value for each of a million
    chunks takes minutes."""
    if node.shape is None:
        return True
    values = math.prod(node.chunks or node.shape)
    chunk, count = values * node.dtype.itemsize, node.size / max(values, 1)
    return bool(max(node.nbytes, chunk) < 1 << 28 and count < 10_000)


def hdf5(path: Path, rng: random.Random) -> None:
    if rng.random() < 0.35:
        path.write_bytes(data(path.read_bytes(), rng))
        return
    with h5py.File(path, "r+") as file:
        for _ in range(rng.choice((1, 1, 2))):
            names: list[str] = []

            def note(name: str, node: Any, into: list[str] = names) -> None:
                if isinstance(node, h5py.Dataset) and _is_small(node):
                    into.append(name)

            file.visititems(note)
            # what the first change broke cannot be changed again
            with contextlib.suppress(OSError):
                rng.choice(_CHANGES)(file, rng.choice(names), rng) if names else None
    if rng.random() < 0.05:
        path.write_bytes(data(path.read_bytes(), rng))


_NAMES = (
    *("a.h5", "b/c.h5", "/abs.h5", "../up.h5", "a/../../up.h5", "c:\\x.h5", "..\\up.h5", ""),
    *(".h5", "x" * 300 + ".h5", "a.h5", "ä\n.h5", "a.txt", "\x1b[2J.h5", "~/.bashrc"),
)


def archive(path: Path, files: list[bytes], rng: random.Random) -> None:
    """Make an archive of good and bad names and members, sometimes with damaged bytes."""
    if path.name.endswith(".zip"):
        _zip(path, files, rng)
    else:
        _tar(path, files, rng)
    if rng.random() < 0.3:
        path.write_bytes(data(path.read_bytes(), rng, 600))


def _name(rng: random.Random) -> str:
    return rng.choice(_NAMES) if rng.random() < 0.4 else f"r{rng.randrange(5)}.h5"


def _content(files: list[bytes], rng: random.Random) -> bytes:
    zeros = bytes(3_000_000 if rng.random() < 0.2 else 30)
    return rng.choice((*files, *files, b"", b"\x89HDF\r\n\x1a\n" + b"\0" * 100, zeros))


def _zip(path: Path, files: list[bytes], rng: random.Random) -> None:
    kind = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA))
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", kind) as made:
        warnings.simplefilter("ignore")  # of names that are there twice
        for _ in range(rng.choice((0, 1, 1, 2, 4))):
            info = zipfile.ZipInfo(_name(rng) or "x.h5")
            info.compress_type = made.compression
            if rng.random() < 0.15:
                info.external_attr = rng.choice((0o120777, 0o020666, 0o010644, 0o040755)) << 16
            made.writestr(info, _content(files, rng))


def _tar(path: Path, files: list[bytes], rng: random.Random) -> None:
    with tarfile.open(path, "w:gz" if path.name.endswith("gz") else "w") as made:
        for _ in range(rng.choice((0, 1, 1, 2, 4))):
            info, content = tarfile.TarInfo(_name(rng) or "x.h5"), _content(files, rng)
            info.size = len(content)
            if rng.random() < 0.2:
                kinds = "SYMTYPE", "LNKTYPE", "CHRTYPE", "FIFOTYPE", "DIRTYPE"
                info.type = getattr(tarfile, rng.choice(kinds))
                info.linkname, info.size = rng.choice(("/etc/passwd", "../x", "a.h5")), 0
            if rng.random() < 0.05:
                info.pax_headers = {"comment": "x" * rng.choice((10, 20_000_000))}
                info.pax_headers["size"] = rng.choice(("1", "99999999999", "-5"))
            made.addfile(info, io.BytesIO(content))
