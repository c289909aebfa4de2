"""The rows of the scenes table that an export needs, and the scenes' navmeshes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from condvln.export.rows import Row, rows_of
from condvln.export.tables import SnapshotTables
from condvln.sources.gibson import GibsonSource, verified_twin

__all__ = ["NavmeshBytes", "SceneTable"]

NavmeshBytes = Callable[[str, Row], bytes | None]
"""Returns the navmesh built for a scene, from its source and its row of the scenes table; None if it is missing."""


class SceneTable:
    """All scenes of a snapshot.

    Parameters
    ----------
    navmeshes : returns built navmeshes, which are then written to the export; without it only their names are recorded
    """

    def __init__(self, tables: SnapshotTables, navmeshes: NavmeshBytes | None) -> None:
        self._navmeshes = navmeshes
        self._rows = {
            source: {row["scene_id"]: row for batch in tables.batches("scenes", source) for row in rows_of(batch)}
            for source in tables.sources
        }

    def row(self, source: str, scene: str) -> Row:
        """Return one row of the table."""
        return self._rows[source][scene]

    def barred(self, source: str) -> dict[str, str]:
        """Return the reason why a scene's episodes can't be published, by scene; scenes without such a reason are left
        out.
        """
        reasons = {}
        for scene, row in self._rows[source].items():
            if row["navmesh_path"] is None:
                reasons[scene] = "its scene has no navmesh"
            elif self._is_shipped(row) and self.navmesh(source, scene) is None:
                reasons[scene] = "the navmesh built for its scene is missing or changed"
            elif source == GibsonSource.family and verified_twin(scene) in self._rows[source]:
                # The two kinds of annotation are split separately, so one building could otherwise be in two splits.
                reasons[scene] = "its building is there by its verified annotation"
        return reasons

    def navmesh(self, source: str, scene: str) -> bytes | None:
        """Return the built navmesh of a scene; None if none was built or if its hash is not the recorded one."""
        row = self._rows[source][scene]
        data = self._navmeshes(source, row) if self._navmeshes is not None else None
        if data is None or hashlib.sha256(data).hexdigest() != row["navmesh_sha256"]:
            return None
        return data

    def navmesh_path(self, source: str, scene: str) -> tuple[str, bool]:
        """Return the path of a scene's navmesh as manifests state it, and whether the navmesh is a file of the
        export.
        """
        row = self._rows[source][scene]
        return str(row["navmesh_path"]), self._is_shipped(row)

    def _is_shipped(self, row: Row) -> bool:
        return self._navmeshes is not None and bool(row["navmesh_built"])
