"""Which files in an export's folder belong to the export; all others are the user's and are kept on re-export."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

import orjson

from condvln.formats.regular_file import read_regular

__all__ = [
    "CERTIFICATES",
    "CHANGELOG",
    "INDEX",
    "ORIGIN",
    "SUMMARY",
    "document_digest",
    "exported_snapshot",
    "file_hashes",
    "owned_files",
    "read_document",
    "read_index",
    "stale_proofs",
]

INDEX: Final = "export.json"
"""The export's index: its counts, and every file with its hash."""

ORIGIN: Final = "origin.json"
"""The inputs of the export; the next export is compared with them."""

CHANGELOG: Final = "CHANGELOG.md"
"""The history of the folder."""

CERTIFICATES: Final = "certificates"
"""Folder with ``<split>.jsonl``, one proof per episode, and their summary."""

SUMMARY: Final = "summary.json"

_WITHOUT_HASH: Final = (INDEX, ORIGIN, CHANGELOG)
_VIEWPOINTS: Final = ("viewpoints/R2R_*.json", "viewpoints/manifest/*.jsonl", f"viewpoints/{INDEX}")
_PROOFS: Final = (f"{CERTIFICATES}/*.jsonl", f"{CERTIFICATES}/{SUMMARY}")


def read_index(folder: Path) -> dict[str, Any] | None:
    """Return the export's index; None if the folder has no index or the index can't be read."""
    return read_document(folder / INDEX)


def read_document(path: Path) -> dict[str, Any] | None:
    """Return the JSON object in a file; None if the file does not exist or its JSON object can't be read."""
    try:
        document = orjson.loads(read_regular(path))
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


def document_digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document without its own ``digest``. The hash shows whether a document was changed or
    truncated.
    """
    rest = {key: value for key, value in document.items() if key != "digest"}
    return hashlib.sha256(orjson.dumps(rest, option=orjson.OPT_SORT_KEYS)).hexdigest()


def exported_snapshot(folder: Path) -> str:
    """Return the id of the snapshot that a folder's export was made from; empty if there is no export."""
    index = read_index(folder)
    return str(index["snapshot"]) if index is not None and "snapshot" in index else ""


def file_hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file by path, as listed in the indexes of the export and of its paths
    over viewpoints; empty if neither can be read.
    """
    found: dict[str, str] = {}
    for part in ("viewpoints/", ""):
        try:
            files = (read_index(folder / part) or {})["files"]
            found |= {f"{part}{path}": str(entry["sha256"]) for path, entry in files.items()}
        except (KeyError, TypeError, AttributeError):
            continue
    return found


def owned_files(folder: Path) -> set[str]:
    """Return the paths below ``folder`` of the files that the export wrote, without the certificates that prove the
    export.

    Paths that lead out of the folder are never included, whatever the index says.
    """
    index = read_index(folder) or {}
    listed = index.get("files")
    names = {*_WITHOUT_HASH}
    for name in listed if isinstance(listed, dict) else ():
        path = PurePosixPath(name)
        if not path.is_absolute() and ".." not in path.parts:
            names.add(str(path))
    names |= {path.relative_to(folder).as_posix() for pattern in _VIEWPOINTS for path in folder.glob(pattern)}
    return names


def stale_proofs(folder: Path, files: dict[str, str]) -> set[str]:
    """Return the paths of all certificates in ``folder`` if they no longer hold, else an empty set. They hold if
    ``files`` has the same hash as the certificates' record for every file that the certificates prove.
    """
    proofs = {path.relative_to(folder).as_posix() for pattern in _PROOFS for path in folder.glob(pattern)}
    try:
        proven = orjson.loads(read_regular(folder / CERTIFICATES / SUMMARY))["files"]
        current = bool(proven) and all(files.get(name) == digest for name, digest in proven.items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        current = False
    return set() if current else proofs
