"""Connectivity graphs of Matterport3D scans, read when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from condvln.navigation.graph_pathfinder import GraphPathfinder

__all__ = ["GraphFolder"]

_SUFFIX: Final = "_connectivity.json"


class GraphFolder(Mapping[str, GraphPathfinder]):
    """Graph by scan over folders of ``<scan>_connectivity.json``; of two files of one scan the first folder's counts.

    Raises
    ------
    FormatError : on asking for a scan whose file is damaged
    """

    def __init__(self, *folders: Path) -> None:
        self._files: dict[str, Path] = {}
        self._read: dict[str, GraphPathfinder] = {}
        for folder in folders:
            for path in sorted(folder.glob(f"*{_SUFFIX}")):
                self._files.setdefault(path.name.removesuffix(_SUFFIX), path)

    def __getitem__(self, scan: str) -> GraphPathfinder:
        if scan not in self._read:
            self._read[scan] = GraphPathfinder.load(self._files[scan])
        return self._read[scan]

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)
