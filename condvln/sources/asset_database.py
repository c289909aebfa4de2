"""ProcTHOR's asset database: each asset's type, and the size of its box at rotation zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import parse_json
from condvln.sources.input_ledger import InputLedger
from schemas.errors import MissingFileError

__all__ = ["Asset", "AssetDatabase"]

FILE_NAMES: Final = ("asset-database.json", "databases/asset-database.json")
MAX_DATABASE_BYTES: Final = 256 << 20


@dataclass(frozen=True, eq=False, slots=True)
class Asset:
    """An asset: its object type, and the full size (3,) of its box in metres. `size` is None if the database has no
    box.
    """

    asset_id: str
    object_type: str
    size: NDArray[np.float64] | None


class AssetDatabase:
    """The assets of the database, by id.

    Raises
    ------
    MissingFileError : the database does not exist
    FormatError : it is malformed
    """

    def __init__(self, root: DatasetRoot) -> None:
        self.path = next((name for name in FILE_NAMES if root.has(name)), FILE_NAMES[0])
        file = root.folder / self.path
        if not root.has(self.path):
            raise MissingFileError(
                "the asset database does not exist",
                where=file,
                remedy="Put ProcTHOR's asset-database.json (allenai/procthor, procthor/databases) beside the houses",
            )
        document = parse_json(root.read(self.path, MAX_DATABASE_BYTES), str(file))
        self._assets: dict[str, Asset] = {}
        for kind, assets in document.items():
            for node in assets.elements():
                own, box = node["assetId"].text(), node.get("boundingBox")
                if own in self._assets:
                    node.fail(f"two assets have the id {own!r}")
                size = None if box is None else np.array([box[c].number() for c in "xyz"])
                if size is not None and not (size >= 0).all():
                    node["boundingBox"].fail("a size is negative")
                own_kind = node.get("objectType")
                self._assets[own] = Asset(own, kind if own_kind is None else own_kind.text(), size)

    def asset(self, asset_id: str, ledger: InputLedger) -> Asset | None:
        """Return an asset; None if the database does not have it, as for assets from Objaverse."""
        found = self._assets.get(asset_id)
        said = None if found is None else [found.object_type, None if found.size is None else found.size.tolist()]
        ledger.entry(self.path, asset_id, said)
        return found
