"""Reader and writer of an export's evaluation manifest, ``manifest/<split>.jsonl``."""

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
