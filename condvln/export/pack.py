"""Write an export as one file that repeats byte for byte, and read it again as if it were hostile.

A pack is a tar archive in zstd. Its first member is the index (`schemas.benchmark.BenchmarkPack`); the export's files
follow in the index's order; equal contents are stored once. ``.gz`` files are stored decompressed, so that zstd finds
what they have in common, and are compressed again when they are unpacked.
"""

from __future__ import annotations

import hashlib
import shutil
import tarfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final

import orjson
import pyarrow as pa
from pydantic import ValidationError

from condvln.export.contents import CERTIFICATES, CHANGELOG, INDEX, document_digest, owned_files, read_index
from condvln.formats.regular_file import open_regular, read_regular
from condvln.formats.streams import GZIP_LEVEL, atomic_copy, atomic_path, atomic_stream, write_file
from schemas.base import first_fault
from schemas.benchmark import BenchmarkPack, PackedFile
from schemas.errors import FormatError, MissingFileError, StoreError

__all__ = ["RECORD", "PackReader", "open_pack", "packed_files", "write_pack"]

RECORD: Final = "benchmark.json"
"""The index of a pack, in the pack and in the export that is unpacked from it."""

MAX_INDEX_BYTES: Final = 64 << 20
MAX_BYTES: Final = 64 << 30
"""Largest content of a pack; 14,000 episodes have some 300 MB."""
_MAX_FILE: Final = 4 << 30
_LEVEL: Final = 22
"""The level with the largest window, 128 MiB: the layouts of a split repeat one another, so packs are half as large."""
_FRAME: Final = 256 << 20
"""Bytes that are compressed at a time."""
_PIECE: Final = 1 << 20
_GZIP: Final = 31
_REMEDY: Final = "Download the pack again, from where it is published"


def packed_files(export: Path, licensed: Iterable[str]) -> list[PackedFile]:
    """Return the export's own files and its certificates, in the order of the pack: what resembles each other is near.

    The export's changelog is left out: it tells of the folder, not of the episodes.

    licensed : families whose built navmeshes are left out
    """
    proofs = {path.relative_to(export).as_posix() for path in (export / CERTIFICATES).glob("*.json*")}
    names = {name for name in (owned_files(export) | proofs) - {CHANGELOG} if (export / name).is_file()}
    kept_out = tuple(f"navmeshes/{family}/" for family in licensed)
    return [_packed(export, name, not name.startswith(kept_out)) for name in sorted(names, key=_place)]


def _place(name: str) -> tuple[str, str]:
    folder, _, rest = name.partition("/")
    return rest.partition("/")[0] if rest.count("/") else folder, name


def _packed(export: Path, name: str, stored: bool) -> PackedFile:
    data = read_regular(export / name)
    found = PackedFile(path=name, bytes=len(data), sha256=hashlib.sha256(data).hexdigest(), stored=stored)
    if not name.endswith(".gz"):
        return found
    reader = zlib.decompressobj(_GZIP)
    try:
        content = reader.decompress(data, _MAX_FILE)
    except zlib.error:
        return found
    packer = zlib.compressobj(GZIP_LEVEL, zlib.DEFLATED, _GZIP)
    if packer.compress(content) + packer.flush() != data:  # larger than the limit, or written by another zlib
        return found
    known = len(content), hashlib.sha256(content).hexdigest()
    return found.model_copy(update={"level": GZIP_LEVEL, "content": known})


def write_pack(out: Path, export: Path, index: BenchmarkPack) -> int:
    """Write the pack of an export; return its size in bytes. Equal exports give equal bytes, whatever the clock, the
    user and the machine.

    Raises
    ------
    StoreError : the pack can't be written
    """
    with atomic_path(out) as part, part.open("wb") as file:
        pending = bytearray()

        def put(data: bytes, last: bool = False) -> None:
            pending.extend(data)
            if len(pending) >= _FRAME or last:
                file.write(pa.Codec("zstd", compression_level=_LEVEL).compress(bytes(pending), asbytes=True))
                pending.clear()

        document = index.model_dump(mode="json", exclude_defaults=True)
        put(_member(RECORD, orjson.dumps(document, option=orjson.OPT_SORT_KEYS) + b"\n"))
        for entry in _contents(index.files):
            data = read_regular(export / entry.path)
            put(_member(_name(entry), data if entry.content is None else zlib.decompress(data, _GZIP)))
        put(bytes(2 * tarfile.BLOCKSIZE), last=True)
    return out.stat().st_size


def _contents(files: Sequence[PackedFile]) -> Iterator[PackedFile]:
    """Yield the first file of each content that the pack holds."""
    seen: set[str] = set()
    for entry in files:
        if entry.stored and entry.sha256 not in seen:
            seen.add(entry.sha256)
            yield entry


def _name(entry: PackedFile) -> str:
    name = entry.path if entry.content is None else entry.path.removesuffix(".gz")
    return name if len(name.encode()) <= tarfile.LENGTH_NAME else entry.sha256  # what every tar can name


def _member(name: str, data: bytes) -> bytes:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    return info.tobuf(tarfile.USTAR_FORMAT) + data + bytes(-len(data) % tarfile.BLOCKSIZE)


class PackReader:
    """An open pack, read once from its begin to its end. Nothing in it is believed: sizes are met by what was read,
    contents by their hash, and members are those of the index, in its order.

    index : the pack's index
    """

    def __init__(self, path: Path, stream: IO[bytes]) -> None:
        self._path = path
        self._stream = stream
        self.document = self._read(self._begin(RECORD, MAX_INDEX_BYTES))
        try:
            self.index = BenchmarkPack.model_validate_json(self.document)
        except ValidationError as error:
            raise self._broken(f"its index can't be read: {first_fault(error)}") from None
        if sum(self._size(entry) for entry in self.index.files) > MAX_BYTES:
            raise self._broken(f"its files are said to have more than {MAX_BYTES:,} bytes")

    def extract(self, folder: Path) -> list[str]:
        """Write the export's files below a new folder; return the paths of those whose content is the same and whose
        compressed bytes differ, since this machine's zlib is another. The export's own list then has their hashes.

        Raises
        ------
        FormatError : the pack is broken
        StoreError : a file can't be written, or there is no room for them
        """
        needed, free = sum(entry.bytes for entry in self.index.files), shutil.disk_usage(folder).free
        if needed > free:
            raise StoreError(f"the pack needs {needed:,} bytes, and {free:,} are free", where=folder)
        written: dict[str, str] = {}
        others: dict[str, dict[str, Any]] = {}
        for entry in self.index.files:
            if not entry.stored:
                continue
            first = written.setdefault(entry.sha256, entry.path)
            if first != entry.path:
                atomic_copy(folder / first, folder / entry.path)
            else:
                self._write(entry, folder / entry.path, others)
            if first in others:
                others[entry.path] = others[first]
        index = read_index(folder)
        if others and index is not None and isinstance(index.get("files"), dict):
            index["files"] |= others
            index["digest"] = document_digest(index)
            write_file(folder / INDEX, orjson.dumps(index, option=orjson.OPT_INDENT_2) + b"\n")
        write_file(folder / RECORD, self.document)
        return sorted(others)

    def _write(self, entry: PackedFile, target: Path, others: dict[str, dict[str, Any]]) -> None:
        digest, left = hashlib.sha256(), self._size(entry)
        if self._begin(_name(entry), left) != left:
            raise self._broken("it has another size than its index says", entry.path)
        if entry.content is None:
            with atomic_path(target) as part, part.open("wb") as plain:
                for piece in self._pieces(left):
                    digest.update(piece)
                    plain.write(piece)
            good = digest.hexdigest() == entry.sha256
        else:
            with atomic_stream(target, entry.level or 0) as packed:
                for piece in self._pieces(left):
                    digest.update(piece)
                    packed.write(piece)
            good = digest.hexdigest() == entry.content[1] and target.suffix == ".gz"
            if packed.digest.hexdigest() != entry.sha256:
                others[entry.path] = {"bytes": packed.size, "sha256": packed.digest.hexdigest()}
        if not good:
            raise self._broken("its content differs from its hash", entry.path)

    @staticmethod
    def _size(entry: PackedFile) -> int:
        return entry.bytes if entry.content is None else entry.content[0]

    def _begin(self, name: str, most: int) -> int:
        """Read the header of the member that must come next; return its size in bytes."""
        block = self._read(tarfile.BLOCKSIZE)
        try:
            info = tarfile.TarInfo.frombuf(block, "utf-8", "strict")
        except (tarfile.TarError, ValueError):
            raise self._broken("it is no tar archive") from None
        if info.name != name or not info.isreg():
            raise self._broken(f"where {name!r} should be, there is {info.name!r}")
        if not 0 <= info.size <= most:
            raise self._broken(f"it is said to have {info.size:,} bytes, of at most {most:,}", name)
        return info.size

    def _read(self, size: int) -> bytes:
        return b"".join(self._pieces(size))

    def _pieces(self, size: int) -> Iterator[bytes]:
        """Yield `size` bytes in pieces, and pass over what fills the last block."""
        left, end = size, -size % tarfile.BLOCKSIZE
        while left or end:
            try:
                piece = self._stream.read(min(left or end, _PIECE))
            except (OSError, pa.ArrowException) as error:
                raise self._broken(f"it can't be decompressed ({error})") from None
            if not piece:
                raise self._broken("it ends early")
            if left:
                left -= len(piece)
                yield piece
            else:
                end -= len(piece)

    def _broken(self, what: str, place: str = "") -> FormatError:
        return FormatError(f"not a sound pack of a benchmark: {what}", where=self._path, place=place, remedy=_REMEDY)


@contextmanager
def open_pack(path: Path) -> Iterator[PackReader]:
    """Open a pack and read its index.

    Raises
    ------
    FormatError : it is broken, hostile, no pack, or of a newer format
    MissingFileError : it can't be opened
    """
    try:
        file = open_regular(path)
    except OSError as error:
        what = f"the pack can't be opened ({error.strerror})"
        raise MissingFileError(what, where=path, remedy="Name a file that benchmark pack wrote") from None
    with file, pa.CompressedInputStream(file, "zstd") as stream:
        yield PackReader(path, stream)
