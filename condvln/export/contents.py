"""Which files of an export's folder are the export's own; all others are the user's and outlive it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

import orjson

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
"""The export's own record: its counts, and every file with its hash."""

ORIGIN: Final = "origin.json"
"""What the export was made of; the next one is compared with it."""

CHANGELOG: Final = "CHANGELOG.md"
"""The history of the folder."""

CERTIFICATES: Final = "certificates"
"""Folder with ``<split>.jsonl``, one proof an episode, and the summary of them."""

SUMMARY: Final = "summary.json"

_WITHOUT_HASH: Final = (INDEX, ORIGIN, CHANGELOG)
_VIEWPOINTS: Final = ("viewpoints/R2R_*.json", "viewpoints/manifest/*.jsonl")
_PROOFS: Final = (f"{CERTIFICATES}/*.jsonl", f"{CERTIFICATES}/{SUMMARY}")


def read_index(folder: Path) -> dict[str, Any] | None:
    """The export's own record; None where the folder has none, or none that can be read."""
    return read_document(folder / INDEX)


def read_document(path: Path) -> dict[str, Any] | None:
    """A JSON object in a file; None where there is none, or none that can be read."""
    try:
        document = orjson.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


def document_digest(document: Mapping[str, Any]) -> str:
    """SHA-256 over a document without its own ``digest``, by which one that was changed or cut is known."""
    rest = {key: value for key, value in document.items() if key != "digest"}
    return hashlib.sha256(orjson.dumps(rest, option=orjson.OPT_SORT_KEYS)).hexdigest()


def exported_snapshot(folder: Path) -> str:
    """Id of the snapshot that a folder's export was made of; empty where it holds none."""
    index = read_index(folder)
    return str(index["snapshot"]) if index is not None and "snapshot" in index else ""


def file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of each file by path, as the export's own record lists them; empty if that can't be read."""
    try:
        return {str(path): str(entry["sha256"]) for path, entry in (read_index(folder) or {})["files"].items()}
    except (KeyError, TypeError, AttributeError):
        return {}


def owned_files(folder: Path) -> set[str]:
    """Paths below ``folder`` of the files that its export wrote, proofs of it excepted.

    Names that lead out of the folder are never among them, whatever its record says.
    """
    index = read_index(folder) or {}
    listed = index.get("files")
    names = {*_WITHOUT_HASH}
    for name in listed if isinstance(listed, dict) else ():
        path = PurePosixPath(name)
        if not path.is_absolute() and ".." not in path.parts:
            names.add(str(path))
    names |= {path.relative_to(folder).as_posix() for pattern in _VIEWPOINTS for path in folder.glob(pattern)}
    # Left by an export that was killed while it wrote in place, as earlier versions did.
    return names | {str(PurePosixPath(name).with_name(f".{PurePosixPath(name).name}.part")) for name in names}


def stale_proofs(folder: Path, files: dict[str, str]) -> set[str]:
    """Paths of the certificates in ``folder``, unless they prove files of exactly these hashes (by path)."""
    proofs = {path.relative_to(folder).as_posix() for pattern in _PROOFS for path in folder.glob(pattern)}
    try:
        proven = orjson.loads((folder / CERTIFICATES / SUMMARY).read_bytes())["files"]
        current = bool(proven) and all(files.get(name) == digest for name, digest in proven.items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        current = False
    return set() if current else proofs
