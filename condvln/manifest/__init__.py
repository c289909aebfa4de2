"""The evaluation manifest of an export, ``manifest/<split>.jsonl``: its one writer and its one reader."""

from condvln.manifest.manifest import (
    ManifestLine,
    manifest_lines,
    manifest_path,
    manifest_paths,
    manifest_row,
    published_row,
    read_manifest,
)

__all__ = [
    "ManifestLine",
    "manifest_lines",
    "manifest_path",
    "manifest_paths",
    "manifest_row",
    "published_row",
    "read_manifest",
]
