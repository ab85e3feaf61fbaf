"""Reads Strandbake's caches; docs/CACHE.md of Strandbake describes the file.

Lengths are metres, axes are right-handed with y up. S strands, V vertices, F frames.
"""

from __future__ import annotations

import itertools
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

try:
    import h5py
    import numpy as np
except ImportError as error:
    raise ImportError(
        f"strandcache needs h5py and numpy ({error}); install them into this Python: pip install h5py"
    ) from error
from numpy.typing import NDArray

NEWEST_FORMAT_VERSION = 1

# No chunk larger than this is read, as it is unpacked in memory as a whole. Strandbake's have 192 KiB.
LARGEST_CHUNK_BYTES = 1 << 30
# Deflate packs 1032 : 1 at best (258 bytes in two bits), so a packed data set that claims more is lying.
LARGEST_RATIO = 1032

SHUFFLE, DEFLATE = h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE

Floats = NDArray[np.float32]
Selection = slice | NDArray[np.int64]


class CacheError(ValueError):
    """What is wrong with a cache: one sentence that begins with its path."""


class _Damage(Exception):
    """What is wrong; Cache puts the path in front and the advice behind."""


# What h5py raises for a file that is not as it should be.
_H5PY_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError, zlib.error)


@dataclass(frozen=True)
class Provenance:
    """Where a cache comes from."""

    version: str  # the Strandbake that wrote it
    scene: str  # the scene as it was read, then its overrides
    inputs: dict[str, str]  # each input file as the scene names it: its SHA-256
    parameters: dict[str, str]  # each setting that was in force, by its dotted path


@dataclass(frozen=True)
class Stats:
    """Measures of each frame, [F]."""

    largest_stretch: Floats  # largest |length / rest length - 1| of a segment
    residual: Floats  # the same, of segments with a pinned vertex at their end or beyond it
    deepest_penetration: Floats  # metres that the deepest vertex lies in a collider
    substeps: NDArray[np.int32]


@dataclass(frozen=True)
class Region:
    """A region of the groom. Slices where its strands follow each other: what they select is a view then."""

    name: str
    strands: Selection  # into what has a value for each strand
    vertices: Selection  # into what has a value for each vertex


class Strands(Sequence[Floats]):
    """Vectors of all vertices seen as strands: item s is a view [vertices of s, 3], root first."""

    def __init__(self, vectors: Floats, offset: NDArray[np.int64]) -> None:
        self._vectors, self._offset = vectors, offset

    def __len__(self) -> int:
        return len(self._offset) - 1

    @overload
    def __getitem__(self, strand: int) -> Floats: ...
    @overload
    def __getitem__(self, strand: slice) -> list[Floats]: ...
    def __getitem__(self, strand: int | slice) -> Floats | list[Floats]:
        if isinstance(strand, slice):
            return [self[s] for s in range(*strand.indices(len(self)))]
        if not -len(self) <= strand < len(self):
            raise IndexError(f"strand {strand} of {len(self)}")
        strand %= len(self)
        return self._vectors[self._offset[strand] : self._offset[strand + 1]]


class Frame:
    """One frame. Positions and velocities are read when they are first asked for, and kept."""

    def __init__(self, cache: Cache, index: int) -> None:
        self._cache, self.index = cache, index
        self.number = int(cache.numbers[index])  # in the scene
        self.time = float(cache.times[index])  # seconds
        self.head: NDArray[np.float64] = cache.heads[index]  # [4, 4], takes columns from the rest place to this frame's
        self.colliders: NDArray[np.float64] = cache.colliders[index]  # [C, 4], centre in the world and radius of each

    @cached_property
    def positions(self) -> Floats:
        """[V, 3], metres in the world."""
        return self._cache.positions(self.index)

    @cached_property
    def velocities(self) -> Floats:
        """[V, 3], m/s. Raises CacheError where the cache has none."""
        return self._cache.velocities(self.index)

    @property
    def strands(self) -> Strands:
        """Positions, strand by strand, without a copy."""
        return Strands(self.positions, self._cache.offset)

    def region(self, name: str) -> Floats:
        """Positions of a region's vertices: a view where its strands follow each other."""
        return self.positions[self._cache.region(name).vertices]


class Cache(Sequence[Frame]):
    """A cache, or the .part of a bake that runs or was ended: a sequence of its finished frames.

    Raises CacheError for anything that is not a cache, is damaged, or is of a newer format version.
    """

    path: str
    fps: float
    complete: bool  # False: a .part
    precision: float  # positions were rounded to half of this, in metres; 0: not at all
    offset: NDArray[np.int64]  # [S + 1], strand s has the vertices offset[s] to offset[s + 1] - 1, root first
    strand_region: NDArray[np.uint32]  # [S], index into regions
    regions: tuple[Region, ...]
    root_uv: Floats | None  # [S, 2], scalp coordinates
    numbers: NDArray[np.int32]  # [F], frame numbers, increasing
    times: NDArray[np.float64]  # [F], seconds
    heads: NDArray[np.float64]  # [F, 4, 4]
    colliders: NDArray[np.float64]  # [F, C, 4], centre in the world and radius; C is 0 where the cache has none
    stats: Stats | None
    provenance: Provenance
    has_velocities: bool

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._file = self._open_file()
        try:
            self._read()
        except CacheError:
            self._file.close()
            raise
        except (_Damage, *_H5PY_ERRORS) as error:
            self._file.close()
            raise self._damaged(error) from error

    def close(self) -> None:
        """Arrays that were read stay; nothing more can be read."""
        self._file.close()

    def __enter__(self) -> Cache:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [Frame(self, i) for i in range(*index.indices(len(self)))]
        return Frame(self, self._checked(index))

    def __iter__(self) -> Iterator[Frame]:
        return (Frame(self, index) for index in range(len(self)))

    @property
    def strand_count(self) -> int:
        return len(self.offset) - 1

    @property
    def vertex_count(self) -> int:
        return int(self.offset[-1])

    def at(self, number: int) -> Frame:
        """The frame of this number in the scene; KeyError where there is none."""
        index = int(np.searchsorted(self.numbers, number))
        if index == len(self) or self.numbers[index] != number:
            have = f"{self.numbers[0]} to {self.numbers[-1]}" if len(self) else "none"
            raise KeyError(f"{self.path}: has no frame {number}; it has {have}")
        return Frame(self, index)

    def region(self, name: str) -> Region:
        """KeyError where there is none of this name."""
        for region in self.regions:
            if region.name == name:
                return region
        raise KeyError(f"{self.path}: has no region {name}; it has {', '.join(r.name for r in self.regions)}")

    def positions(self, index: int, out: Floats | None = None) -> Floats:
        """Positions of the frame at `index`, [V, 3]; into `out` where it is given."""
        return self._vectors(self._position, index, out)

    def velocities(self, index: int, out: Floats | None = None) -> Floats:
        """Mean velocities over the frame that ends at `index`, [V, 3]."""
        if self._velocity is None:
            raise CacheError(f"{self.path}: has no velocities; bake it with cache.velocity = true")
        return self._vectors(self._velocity, index, out)

    @cached_property
    def rest(self) -> Floats:
        """The groom at rest, [V, 3]."""
        if not self._file:
            raise CacheError(f"{self.path}: was closed")
        try:
            rest = np.empty((self.vertex_count, 3), np.float32)
            _read_rows(self._rest, 0, rest)
            _require_finite("/rest/position", rest)
        except (_Damage, *_H5PY_ERRORS) as error:
            raise self._damaged(error) from error
        return rest

    def _vectors(self, data: _Data, index: int, out: Floats | None) -> Floats:
        index = self._checked(index)
        if not self._file:
            raise CacheError(f"{self.path}: was closed")
        if out is None:
            out = np.empty((self.vertex_count, 3), np.float32)
        elif out.shape != (self.vertex_count, 3) or out.dtype != np.float32 or not out.flags.c_contiguous:
            raise ValueError(f"out needs to be float32 [{self.vertex_count}, 3] in C order")
        try:
            _read_rows(data, index, out[None])
            _require_finite(f"{data.name} of frame {self.numbers[index]}", out)
        except (_Damage, *_H5PY_ERRORS) as error:
            raise self._damaged(error) from error
        return out

    def _checked(self, index: int) -> int:
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.path}: frame index {index} of {len(self)}")
        return index % len(self)

    def _damaged(self, error: BaseException) -> CacheError:
        return CacheError(f"{self.path}: is damaged: {_sentence(error)}; bake it again")

    def _open_file(self) -> h5py.File:
        if not os.path.exists(self.path):
            raise CacheError(f"{self.path}: there is no such file")
        if os.path.isdir(self.path):
            raise CacheError(f"{self.path}: is a folder, not a cache")
        if not os.path.isfile(self.path):
            raise CacheError(f"{self.path}: is not a regular file")
        try:
            return h5py.File(self.path, "r", locking=False)  # a bake in progress may be looked at
        except _H5PY_ERRORS as error:
            if not os.access(self.path, os.R_OK):
                raise CacheError(f"{self.path}: may not be read") from error
            with open(self.path, "rb") as file:
                is_hdf5 = file.read(8) == b"\x89HDF\r\n\x1a\n"
            what = "is a damaged or truncated HDF5 file; bake it again" if is_hdf5 else "is not an HDF5 file"
            raise CacheError(f"{self.path}: {what} ({_sentence(error)})") from error

    def _read(self) -> None:
        file, size = self._file, os.path.getsize(self.path)
        try:
            ours = _text_attribute(file, "format") == "strandbake"
        except (_Damage, *_H5PY_ERRORS):
            ours = False
        if not ours:
            raise CacheError(f"{self.path}: is an HDF5 file, but not a Strandbake cache")
        version = int(_number_attribute(file, "format_version", "<i4"))
        if version > NEWEST_FORMAT_VERSION:
            raise CacheError(
                f"{self.path}: has cache format version {version}, but this package reads up to "
                f"{NEWEST_FORMAT_VERSION}; use a newer strandcache"
            )
        if version < 1:
            raise _Damage(f"format version {version} has never been")
        self.fps = float(_number_attribute(file, "fps", "<f8"))
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise _Damage(f"fps is {self.fps}")
        self._read_strands(size)
        self._read_provenance(size)
        self._read_frames(size)

    def _read_strands(self, size: int) -> None:
        file = self._file
        self._rest = _dataset(file, size, "/rest/position", "<f4", (None, 3))
        vertices = self._rest.shape[0]
        offset = _all(_dataset(file, size, "/strands/offset", "<u8", (None,)))
        if len(offset) < 2:
            raise _Damage("/strands/offset has no strand")
        if offset[0] != 0:
            raise _Damage(f"/strands/offset starts at {offset[0]}")
        falls = np.flatnonzero(offset[1:] <= offset[:-1])
        if len(falls):
            raise _Damage(f"/strands/offset does not increase at strand {falls[0]}")
        if offset[-1] != vertices:
            raise _Damage(f"/strands/offset ends at {offset[-1]}, but there are {vertices} vertices")
        self.offset = offset.astype(np.int64)

        names = _texts(file, size, "/regions/name", 1)
        strands = len(offset) - 1
        self.strand_region = _all(_dataset(file, size, "/strands/region", "<u4", (strands,)))
        wrong = np.flatnonzero(self.strand_region >= len(names))
        if len(wrong):
            raise _Damage(f"strand {wrong[0]} is in region {self.strand_region[wrong[0]]}, but there are {len(names)}")
        self.regions = tuple(self._make_region(index, name) for index, name in enumerate(names))
        self.root_uv = None
        if "/strands/root_uv" in file:
            self.root_uv = _all(_dataset(file, size, "/strands/root_uv", "<f4", (strands, 2)))

    def _make_region(self, index: int, name: str) -> Region:
        strands = np.flatnonzero(self.strand_region == index)
        first, last = (int(strands[0]), int(strands[-1])) if len(strands) else (0, -1)
        if last - first + 1 == len(strands):
            return Region(name, slice(first, last + 1), slice(int(self.offset[first]), int(self.offset[last + 1])))
        starts, counts = self.offset[strands], np.diff(self.offset)[strands]
        before = np.cumsum(counts) - counts
        return Region(name, strands, np.arange(counts.sum()) + np.repeat(starts - before, counts))

    def _read_provenance(self, size: int) -> None:
        def pairs(name: str, value: str) -> dict[str, str]:
            keys, values = _texts(self._file, size, f"{name}/name", 1), _texts(self._file, size, f"{name}/{value}", 1)
            if len(keys) != len(values):
                raise _Damage(f"{name} has {len(keys)} names and {len(values)} values")
            return dict(zip(keys, values))

        self.provenance = Provenance(
            _text_attribute(self._file["/provenance"], "version"),
            _texts(self._file, size, "/provenance/scene", 0)[0],
            pairs("/provenance/inputs", "sha256"),
            pairs("/provenance/parameters", "value"),
        )

    def _read_frames(self, size: int) -> None:
        """A killed bake may leave one frame more in one data set than in another: those that all have count."""
        file = self._file
        opened: list[_Data] = []

        def frames(name: str, kind: str, *shape: int | None) -> _Data:
            opened.append(_dataset(file, size, name, kind, (None, *shape)))
            return opened[-1]

        self._position = frames("/frames/position", "<f4", self.vertex_count, 3)
        self.precision = float(_number_attribute(self._position.handle, "precision", "<f8"))
        if not (np.isfinite(self.precision) and self.precision >= 0):
            raise _Damage(f"the precision of /frames/position is {self.precision}")
        number, time = frames("/frames/number", "<i4"), frames("/frames/time", "<f8")
        head = frames("/frames/head", "<f8", 4, 4)
        self.has_velocities = "/frames/velocity" in file
        self._velocity = frames("/frames/velocity", "<f4", self.vertex_count, 3) if self.has_velocities else None
        collider = frames("/frames/collider", "<f8", None, 4) if "/frames/collider" in file else None
        measures = []
        if "/stats" in file:
            measures = [
                frames("/stats/largest_stretch", "<f4"),
                frames("/stats/residual", "<f4"),
                frames("/stats/deepest_penetration", "<f4"),
                frames("/stats/substeps", "<i4"),
            ]
        counts = [data.shape[0] for data in opened]
        self.complete = bool(_number_attribute(file, "complete", "|u1"))
        if self.complete and min(counts) != max(counts):
            raise _Damage(f"it calls itself complete, but has {min(counts)} to {max(counts)} frames")
        first = min(counts)
        self.numbers, self.times, self.heads = _all(number, first), _all(time, first), _all(head, first)
        self.colliders = _all(collider, first) if collider else np.empty((first, 0, 4))
        self.stats = Stats(*(_all(measure, first) for measure in measures)) if measures else None
        if np.any(np.diff(self.numbers.astype(np.int64)) <= 0):
            raise _Damage("/frames/number does not increase")
        _require_finite("/frames/time", self.times)
        _require_finite("/frames/head", self.heads)


def _sentence(error: BaseException) -> str:
    """The first line of what h5py says, which names a missing object in quotes of its own."""
    text = str(error.args[0] if isinstance(error, KeyError) and error.args else error)
    return (text.splitlines() or [type(error).__name__])[0].rstrip(".")


def _require_finite(name: str, values: NDArray[Any]) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        raise _Damage(
            f"{name} has a value that is not finite, at {int(np.argmin(finite.reshape(len(values), -1).all(axis=1)))}"
        )


def _scalar_attribute(owner: h5py.HLObject, name: str) -> h5py.h5a.AttrID:
    if not h5py.h5a.exists(owner.id, name.encode()):
        raise _Damage(f'there is no attribute "{name}"')
    attribute = h5py.h5a.open(owner.id, name.encode())
    if attribute.get_space().get_simple_extent_npoints() != 1:
        raise _Damage(f'attribute "{name}" is not one value')
    return attribute


def _number_attribute(owner: h5py.HLObject, name: str, kind: str) -> Any:
    attribute = _scalar_attribute(owner, name)
    if attribute.dtype != np.dtype(kind):
        raise _Damage(f'attribute "{name}" is not the number it should be')
    value = np.empty(attribute.shape, kind)
    attribute.read(value)
    return value.reshape(-1)[0]


def _text_attribute(owner: h5py.HLObject, name: str) -> str:
    attribute = _scalar_attribute(owner, name)
    kind = attribute.get_type()
    if (
        not isinstance(kind, h5py.h5t.TypeStringID) or kind.is_variable_str()
    ):  # those lie in a heap, which may be damaged
        raise _Damage(f'attribute "{name}" is not a text')
    value = np.empty(attribute.shape, f"S{kind.get_size()}")
    attribute.read(value, kind)
    return bytes(value.reshape(-1)[0]).decode()


@dataclass(frozen=True)
class _Data:
    """A data set that is stored in the file itself and claims no more than its bytes can hold."""

    name: str
    handle: h5py.Dataset
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunk: tuple[int, ...] | None  # None: contiguous
    filters: tuple[int, ...]  # in the order of writing
    stored: int  # bytes in the file


def _open(file: h5py.File, size: int, name: str) -> _Data:
    if name not in file:
        raise _Damage(f"there is no {name}")
    handle = file[name]
    if not isinstance(handle, h5py.Dataset) or handle.shape is None:
        raise _Damage(f"{name} is not a data set")
    creation = handle.id.get_create_plist()
    layout, value = creation.get_layout(), handle.id.get_type().get_size()
    if layout not in (h5py.h5d.CHUNKED, h5py.h5d.CONTIGUOUS) or creation.get_external_count():
        raise _Damage(f"{name} is not stored in the file itself")
    filters = tuple(creation.get_filter(k)[0] for k in range(creation.get_nfilters()))
    if any(code not in (SHUFFLE, DEFLATE) for code in filters) or len(filters) > 2:
        raise _Damage(f"{name} is packed with other filters than shuffle and deflate")
    chunk = handle.chunks
    if chunk is not None and (0 in chunk or math.prod(chunk) * value > LARGEST_CHUNK_BYTES):
        raise _Damage(f"{name} has impossible chunks")
    stored = min(handle.id.get_storage_size(), size)
    if math.prod(handle.shape) * value > stored * (LARGEST_RATIO if filters else 1):
        raise _Damage(f"{name} claims {math.prod(handle.shape)} values, more than its bytes can hold")
    return _Data(name, handle, handle.shape, handle.dtype, chunk, filters, stored)


def _dataset(file: h5py.File, size: int, name: str, kind: str, shape: tuple[int | None, ...]) -> _Data:
    """A data set of numbers of exactly this type; None in `shape` is any length."""
    data = _open(file, size, name)
    if len(data.shape) != len(shape) or any(want not in (None, found) for want, found in zip(shape, data.shape)):
        wanted = " x ".join("any" if want is None else str(want) for want in shape)
        raise _Damage(f"{name} has the shape {' x '.join(map(str, data.shape))} in place of {wanted}")
    if data.dtype != np.dtype(kind):
        raise _Damage(f"{name} has another type of numbers than format version 1")
    return data


def _texts(file: h5py.File, size: int, name: str, rank: int) -> list[str]:
    data = _open(file, size, name)
    kind = data.handle.id.get_type()
    if not isinstance(kind, h5py.h5t.TypeStringID) or kind.is_variable_str() or len(data.shape) != rank or data.chunk:
        raise _Damage(f"{name} does not hold strings of fixed length")
    texts = np.empty(data.shape, f"S{kind.get_size()}")
    if texts.size:
        data.handle.id.read(h5py.h5s.ALL, h5py.h5s.ALL, texts, kind)
    return [bytes(text).decode() for text in texts.reshape(-1)]


def _all(data: _Data, count: int | None = None) -> NDArray[Any]:
    out = np.empty((data.shape[0] if count is None else count, *data.shape[1:]), data.dtype)
    _read_rows(data, 0, out)
    return out


def _read_rows(data: _Data, first: int, out: NDArray[Any]) -> None:
    """Rows from `first` on, as many as `out` has. Chunks are unpacked here and side by side: HDF5 does one after the
    other, and 1.10 would trust a damaged chunk to unpack to the right size."""
    if out.size == 0:
        return
    if not data.filters:
        data.handle.read_direct(out, np.s_[first : first + len(out)])
        return
    assert data.chunk is not None  # what is not chunked has no filters
    step, end = data.chunk, (first + len(out), *data.shape[1:])
    starts = (first // step[0] * step[0], *(0 for _ in step[1:]))
    corners = list(itertools.product(*(range(a, b, c) for a, b, c in zip(starts, end, step))))

    def read(corner: tuple[int, ...]) -> None:
        chunk = _read_chunk(data, corner)
        low = (max(corner[0], first), *corner[1:])
        high = tuple(min(c + s, e) for c, s, e in zip(corner, step, end))
        into = (slice(low[0] - first, high[0] - first), *(slice(a, b) for a, b in zip(low[1:], high[1:])))
        out[into] = chunk[tuple(slice(a - c, b - c) for a, b, c in zip(low, high, corner))]

    if len(corners) == 1:
        read(corners[0])
    else:
        list(_pool().map(read, corners))


def _read_chunk(data: _Data, corner: tuple[int, ...]) -> NDArray[Any]:
    assert data.chunk is not None
    info = data.handle.id.get_chunk_info_by_coord(corner)
    if info.byte_offset is None:
        raise _Damage(f"{data.name} lacks a part of row {corner[0]}")
    size = math.prod(data.chunk) * data.dtype.itemsize
    if info.size > min(data.stored, size + size // 1000 + 1024):  # deflate adds 5 bytes to 16 KiB that it cannot pack
        raise _Damage(f"{data.name} has a chunk of a wrong size")
    skipped, packed = data.handle.id.read_direct_chunk(corner)
    for k, code in reversed(list(enumerate(data.filters))):
        if skipped >> k & 1:
            continue
        if code == DEFLATE:
            packed = zlib.decompress(packed, bufsize=size)
        elif len(packed) == size:
            planes = np.frombuffer(packed, np.uint8).reshape(data.dtype.itemsize, -1)
            values = np.empty((planes.shape[1], planes.shape[0]), np.uint8)
            for byte, plane in enumerate(planes):  # three times faster than one transposition
                values[:, byte] = plane
            packed = values.data
    if memoryview(packed).nbytes != size:
        raise _Damage(f"{data.name} has a chunk of a wrong size")
    return np.frombuffer(packed, data.dtype).reshape(data.chunk)


_threads: ThreadPoolExecutor | None = None


def _pool() -> ThreadPoolExecutor:
    global _threads
    if _threads is None:
        _threads = ThreadPoolExecutor(min(8, os.cpu_count() or 1), "strandcache")
    return _threads
