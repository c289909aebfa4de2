"""The part of an export whose episodes are on viewpoint graphs: ``viewpoints/R2R_<split>.json``, with manifests of its
own.

The folder can be read like an export: ``condvln evaluate EXPORT/viewpoints val_unseen …``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from condvln.export.graph_episodes import GraphEpisode
from condvln.export.report import WrittenFile
from condvln.export.splits import SPLITS
from condvln.export.vlnce import encode
from condvln.formats.streams import ByteStream, JsonArrayStream, atomic_stream
from condvln.manifest import manifest_path, manifest_row

__all__ = ["FOLDER", "ViewpointReport", "write_viewpoints"]

FOLDER: Final = "viewpoints"
_SOURCE: Final = "mp3d"


@dataclass
class ViewpointReport:
    """Numbers of placed episodes by split, the scans of each split, and the numbers of episodes that could not be
    placed, by reason.
    """

    episodes: dict[str, int] = field(default_factory=dict)
    scans: dict[str, list[str]] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    files: dict[str, WrittenFile] = field(default_factory=dict)
    """Files by path below the export's folder."""

    def document(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        return {"episodes": self.episodes, "scans": self.scans, "left_out": self.left_out}


def write_viewpoints(
    out: Path, episodes: Iterable[GraphEpisode], snapshot: str, left_out: Counter[str] | None = None
) -> ViewpointReport:
    """Write the episodes below ``out/viewpoints``, each file atomically; a split without episodes gets no file.

    Parameters
    ----------
    out : the export's folder
    episodes : episodes ordered by scan; all episodes of a scan are in one split
    snapshot : id of the episodes' snapshot
    left_out : counts by reason, filled by the iterator `episodes` and read at its end

    Raises
    ------
    StoreError : a file can't be written
    """
    report = ViewpointReport()
    folder = out / FOLDER
    opened: dict[str, tuple[JsonArrayStream, ByteStream]] = {}
    with ExitStack() as stack:
        for episode in episodes:
            split = episode.split
            if split not in opened:
                items = stack.enter_context(atomic_stream(folder / f"R2R_{split}.json", closing=b"]\n"))
                items.write(b"[")
                manifest = stack.enter_context(atomic_stream(manifest_path(folder, split)))
                opened[split] = JsonArrayStream(items), manifest
            items_of, manifest = opened[split]
            items_of.entry(encode(episode.item))
            scan = episode.row["scene_id"]
            names = {
                "source": _SOURCE,
                "split": split,
                "navmesh": f"connectivity/{scan}_connectivity.json",
                "snapshot": snapshot,
            }
            manifest.write(encode(manifest_row(episode.row, episode.instruction, **names)) + b"\n")
            report.episodes[split] = report.episodes.get(split, 0) + 1
            scans = report.scans.setdefault(split, [])
            if scan not in scans:
                scans.append(scan)
    for stream in [each for items_of, manifest in opened.values() for each in (items_of.stream, manifest)]:
        name = stream.path.relative_to(out).as_posix()
        report.files[name] = WrittenFile(stream.size, stream.digest.hexdigest())
    report.left_out = dict(sorted((left_out or Counter()).items()))
    for split in SPLITS:
        if split not in opened:
            (folder / f"R2R_{split}.json").unlink(missing_ok=True)
            manifest_path(folder, split).unlink(missing_ok=True)
    return report
