"""The Habitat Synthetic Scenes Dataset (HSSD, ``hssd-hab``): a Habitat scene dataset with a table of its models.

Scenes, object configurations and rooms are those of a Habitat scene dataset. Labels are in ``semantics/objects.csv``:
the column ``id`` is the name of a model's template, ``main_category`` its category. A model that is not in the table
has the semantic class of its configuration. Templates in ``objects/openings/`` have neither and are doors or windows.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, Final

from condvln.formats.csv_table import csv_columns
from condvln.labels import vocabulary
from condvln.sources.body import BodyReader
from condvln.sources.input_ledger import InputLedger
from condvln.sources.lexicon import Lexicon
from condvln.sources.replicacad import ReplicaCadSource
from condvln.sources.scene_dataset import SceneDataset, Template
from condvln.sources.scene_instance import Placed

__all__ = ["HssdSource"]

TABLE: Final = "semantics/objects.csv"
MAX_TABLE_BYTES: Final = 64 << 20
"""Size limit in bytes of the table of models; the released one has 4.4 MB."""

OPENINGS: Final = "objects/openings/"
OPENING: Final = "opening"
"""Raw label of templates in the folder of openings, which have no category."""


class HssdSource(ReplicaCadSource):
    """The scenes of HSSD; raises ConfigError for a folder without a scene dataset."""

    family: ClassVar[str] = "hssd"

    def body_reader(self, dataset: SceneDataset, lexicon: Lexicon, ledger: InputLedger) -> BodyReader:
        """Return the reader of the scene's bodies, which knows the categories of the models."""
        categories: Mapping[str, str] = {}
        if dataset.has(TABLE):
            data = dataset.root.read(TABLE, MAX_TABLE_BYTES)
            categories = _categories(data, str(Path(self.root) / TABLE))
        return _HssdBodyReader(dataset, lexicon, self.family, ledger, categories)


class _HssdBodyReader(BodyReader):
    def __init__(
        self,
        dataset: SceneDataset,
        lexicon: Lexicon,
        family: str,
        ledger: InputLedger,
        categories: Mapping[str, str],
    ) -> None:
        super().__init__(dataset, lexicon, family, ledger)
        self._categories = categories

    def _labels(self, template: Template, placed: Placed) -> tuple[str, str]:
        raw = self._categories.get(template.handle)
        if self._categories:
            self.ledger.entry(TABLE, template.handle, raw)
        if raw is None and template.get("semantic_id") is None and template.path.startswith(OPENINGS):
            raw = OPENING
        if raw is None:
            return super()._labels(template, placed)
        return raw, vocabulary.canonical(raw, self.family)


@lru_cache(maxsize=2)
def _categories(data: bytes, where: str) -> Mapping[str, str]:
    """Return the category of each model by its name. Models without a category are left out.

    Raises
    ------
    FormatError : the table is not text in UTF-8, or lacks a column
    """
    rows = csv_columns(data, ("id", "main_category"), where)
    return {name: category for name, category in rows if name and category}
