"""``condvln samples``: write whole synthetic scenes in a family's native format."""

from __future__ import annotations

from pathlib import Path

import yaml

from condvln.samples import make_samples
from jobs.report import Report

__all__ = ["write_samples"]


def write_samples(folder: Path, *, family: str, scenes: int, seed: int) -> Report:
    """Write `scenes` synthetic scenes under `folder`; the report ends with the source entry for a configuration."""
    made = make_samples(folder, family=family, scenes=scenes, seed=seed)
    source = {"family": made.family, **{key: str(path.resolve()) for key, path in made.parts.items()}}
    document = {
        "folder": str(made.folder),
        "scenes": len(made.scenes),
        "rooms": made.rooms,
        "objects": made.objects,
        "files": made.files,
        "bytes": made.bytes,
        "source": source,
    }
    lines = [
        f"{made.folder}: {len(made.scenes)} scenes, {made.rooms} rooms, {made.objects} objects; "
        f"{made.files} files, {made.bytes:,} bytes",
        "In a configuration:",
        *yaml.safe_dump({"sources": [source]}, sort_keys=False).splitlines(),
    ]
    return Report(document, lines)
