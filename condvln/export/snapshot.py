"""Write a snapshot to an export folder: choose splits, write every variant, count everything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import orjson

from condvln.bias import BiasGate
from condvln.collector import no_collection
from condvln.export.card import dataset_card
from condvln.export.changelog import Generated, PublishedEpisodes, changes_between, with_entry
from condvln.export.consumers import consumer_files
from condvln.export.contents import CHANGELOG, INDEX, document_digest, exported_snapshot
from condvln.export.croissant import croissant
from condvln.export.pool import INSTRUCTION_COLUMNS, POOL_COLUMNS, PoolBuilder
from condvln.export.r2r import Graphs
from condvln.export.report import CardPicture, ExportReport, WrittenFile
from condvln.export.rows import Row, rows_of
from condvln.export.scene_table import NavmeshBytes, SceneTable
from condvln.export.selection import OUT, Selection, select
from condvln.export.splits import SPLITS, Split
from condvln.export.staging import staged
from condvln.export.tables import BATCH_ROWS, JoinedScene, SnapshotTables, instructions_by_scene, joined_by_scene
from condvln.export.tokens import TOKEN_LENGTH, Vocabulary
from condvln.export.variants import ORACLE_COLUMNS, LinearTexts, OracleText, oracle_text_of
from condvln.export.vlnce import SCENE_PATTERNS
from condvln.export.writer import ExportWriter, Layout
from condvln.formats.streams import atomic_stream
from schemas.config import SplitsConfig
from schemas.errors import InputError, StoreError

__all__ = ["ExportConfig", "NavmeshBytes", "export_snapshot"]

Complete = Callable[[Path, ExportReport], None]
"""Called with the new files and their report before they replace the former export."""

Pictures = Callable[[Path], Iterable[CardPicture]]
"""Called with the new folder after the manifests are written; returns the pictures of the dataset card."""

Progress = Callable[[int, int], None]
"""Called with the number of written episodes and of all episodes."""


@dataclass(frozen=True)
class ExportConfig:
    """What is written, and in which form."""

    splits: SplitsConfig = field(default_factory=SplitsConfig)
    scene_patterns: Mapping[str, str] = field(default_factory=lambda: dict(SCENE_PATTERNS))
    """Pattern of ``scene_id`` by family, with ``{family}``, ``{scene}`` and ``{name}``; the entry ``""`` is the
    default.
    """
    token_length: int = TOKEN_LENGTH
    vocabulary: Vocabulary | None = None
    """Vocabulary of a trained agent to use in place of our own; unknown words become UNK."""
    name: str = "CondVLN"
    """Title of the dataset card."""
    texts: Mapping[str, Any] = field(default_factory=dict)
    """The settings with which the texts were rendered: ``seed``, ``preamble``, ``language``, ``voices``, ``length``."""


def export_snapshot(
    tables: SnapshotTables,
    out: Path,
    config: ExportConfig | None = None,
    *,
    oracle_texts: OracleText | None = None,
    navmeshes: NavmeshBytes | None = None,
    graphs: Graphs | None = None,
    former: SnapshotTables | None = None,
    pictures: Pictures | None = None,
    progress: Progress | None = None,
    complete: Complete | None = None,
) -> ExportReport:
    """Write all splits of a snapshot in one pass over its rows, one scene in memory at a time.

    The export is written beside ``out`` and replaces it atomically (``condvln.export.staging``);
    one process at a time may write an ``out``. The user's own files in ``out`` are kept. ``export.json`` lists all
    files with their hashes. The same snapshot and configuration give the same bytes (``CHANGELOG.md`` aside, the
    history of the folder).

    Parameters
    ----------
    oracle_texts : linear texts of the oracle twin; without them no twin is written
    navmeshes : returns built navmeshes, which are then included
    graphs : connectivity by Matterport3D scan; with them the discrete R2R files are written
    former : the previously published snapshot. If the folder holds no export, ``CHANGELOG.md`` compares with this
        snapshot; if it holds this snapshot's export, the snapshot says which episodes were generated but not selected
    pictures : draws the pictures of the dataset card; without it the card has none
    complete : called before the exchange; may add files, or raise an error to keep the former export

    Raises
    ------
    StoreError : the snapshot has no episodes or is damaged, or a file can't be written
    """
    # Rows and their JSON have no cycles: collecting garbage among them would take a tenth of the export.
    with staged(out) as new, no_collection():
        return _write_export(
            tables,
            out,
            new,
            config or ExportConfig(),
            oracle_texts,
            navmeshes,
            graphs,
            former,
            pictures,
            progress,
            complete,
        )


def _write_export(
    tables: SnapshotTables,
    out: Path,
    new: Path,
    config: ExportConfig,
    oracle_texts: OracleText | None,
    navmeshes: NavmeshBytes | None,
    graphs: Graphs | None,
    former: SnapshotTables | None,
    pictures: Pictures | None,
    progress: Progress | None,
    complete: Complete | None,
) -> ExportReport:
    """Write the export that will replace ``out`` into the folder ``new``."""
    report = ExportReport(tables.id, dict(config.texts))
    scenes = SceneTable(tables, navmeshes)
    selection, splits_of, generated = _choose(tables, config, scenes)
    report.cells = selection.cells
    report.left_out = dict(sorted(selection.left_out.items()))
    report.empty_splits = {str(split): why for split, why in selection.empty.items()}
    report.truth_imbalance = selection.truth_imbalance
    kept = LinearTexts(oracle_texts) if callable(oracle_texts) else None
    rows = _JoinedRows(tables, splits_of)
    texts = _texts(rows, splits_of, oracle_texts if kept is None else kept.first)
    vocabulary = config.vocabulary or Vocabulary.of(texts)
    oracle_texts = oracle_texts if kept is None else kept.again
    report.vocabulary = len(vocabulary.words)
    report.episodes = dict.fromkeys(SPLITS, 0)
    report.scenes = {split: [] for split in SPLITS}
    published, before = _formerly(out, exported_snapshot(out), tables.id, former, config)
    splits = config.splits
    layout = Layout(dict(config.scene_patterns), config.token_length, splits.sharded, tables.id)
    gate = BiasGate() if splits.bias != "off" else None
    show = None if gate is None else gate.add
    writer = ExportWriter(new, layout, vocabulary, scenes, report, oracle_texts=oracle_texts, graphs=graphs, show=show)
    with writer.open():
        _write_rows(rows, splits_of, writer, report, progress)
    if gate is not None:
        report.bias = gate.report()
    for picture in pictures(new) if pictures is not None else ():
        _write(new, picture.path, picture.data, report)
        report.pictures[picture.path] = picture.caption
    _write_documents(new, config.name, report)
    _write_changelog(out, new, published, before, generated)
    if complete is not None:
        complete(new, report)
    document = report.document()
    document["digest"] = document_digest(document)
    with atomic_stream(new / INDEX) as stream:
        stream.write(orjson.dumps(document, option=orjson.OPT_INDENT_2) + b"\n")
    return report


def _write_rows(
    rows: _JoinedRows,
    splits_of: SplitCodes,
    writer: ExportWriter,
    report: ExportReport,
    progress: Progress | None,
) -> None:
    total = int(sum((codes != OUT).sum() for codes in splits_of.values()))
    for source, codes in splits_of.items():
        at = 0
        for scene, episodes, instructions in rows.of(source, None):
            here = codes[at : at + len(episodes)].tolist()
            at += len(episodes)
            chosen = [
                (code, row, instructions[row["instruction_id"]])
                for code, row in zip(here, episodes, strict=True)
                if code != OUT
            ]
            if chosen:
                writer.add_scene(source, scene, chosen)
            if progress is not None:
                progress(sum(report.episodes.values()), total)


def _write_documents(out: Path, name: str, report: ExportReport) -> None:
    """Write the card, the metadata and the configuration files, which only restate the report."""
    texts = {
        **consumer_files(report),
        "README.md": dataset_card(report, name),
        "croissant.json": orjson.dumps(croissant(report, name), option=orjson.OPT_INDENT_2).decode() + "\n",
    }
    for path, text in texts.items():
        _write(out, path, text.encode(), report)


def _write(out: Path, path: str, data: bytes, report: ExportReport) -> None:
    with atomic_stream(out / path) as stream:
        stream.write(data)
    report.files[path] = WrittenFile(stream.size, stream.digest.hexdigest())


def _formerly(
    out: Path, exported: str, now: str, former: SnapshotTables | None, config: ExportConfig
) -> tuple[PublishedEpisodes | None, Generated | None]:
    """Return the episodes that the replaced export published, and all episodes of the snapshot from which that export
    was made. Either is None if unknown or if there is no such export.

    The first is read from the folder's manifests, or else from what exporting ``former`` would give; the second is
    known if ``former`` is the published snapshot.
    """
    if exported == now or (not exported and (former is None or former.id == now)):
        return None, None
    published = PublishedEpisodes.of_export(out) if exported else None
    if former is None or (exported and former.id != exported):
        return published, None
    try:
        _, splits_of, generated = _choose(former, config, SceneTable(former, None))
        if published is None:
            published = PublishedEpisodes.of_rows(former.id, _chosen_rows(former, splits_of))
    # the former snapshot has no episodes or is damaged; the new one is exported all the same
    except (StoreError, InputError):
        return published, None
    return published, generated


def _chosen_rows(tables: SnapshotTables, splits_of: SplitCodes) -> Iterator[tuple[Split, str, Row]]:
    for source, codes in splits_of.items():
        rows = (row for batch in tables.batches("episodes", source) for row in rows_of(batch))
        yield from ((SPLITS[code], source, row) for row, code in zip(rows, codes.tolist(), strict=True) if code != OUT)


def _write_changelog(
    out: Path, new: Path, former: PublishedEpisodes | None, before: Generated | None, generated: Generated
) -> None:
    try:
        text = (out / CHANGELOG).read_text(encoding="utf-8")
    except (OSError, ValueError):
        text = ""
    now = PublishedEpisodes.of_export(new) if former is not None else None
    if former is not None and now is not None:  # the dataset card says so if the new export has no episodes
        text = with_entry(text, changes_between(former, now, before=before, now=generated))
    if text:
        with atomic_stream(new / CHANGELOG) as stream:
            stream.write(text.encode())


ROWS_KEPT: Final = BATCH_ROWS
"""Number of episodes up to which the rows of a source are kept: as many as are decoded at a time."""

INSTRUCTIONS_KEPT: Final = 6 * BATCH_ROWS
"""Number of episodes up to which the instructions of a source are kept from the first pass for the second one: up to
60 MB.
"""

SplitCodes = dict[str, npt.NDArray[np.int8]]
"""By source, the split code of each row of the episodes table in reading order."""


class _JoinedRows:
    """The rows of a snapshot scene by scene, for two passes. Those of a small source are decoded once and kept, of a
    larger one the instructions.
    """

    def __init__(self, tables: SnapshotTables, splits_of: SplitCodes) -> None:
        self.tables = tables
        self._few = {source for source, codes in splits_of.items() if len(codes) <= ROWS_KEPT}
        self._kept: dict[str, list[JoinedScene]] = {}
        self._some = {source for source, codes in splits_of.items() if len(codes) <= INSTRUCTIONS_KEPT}
        self._told: dict[str, list[tuple[str, list[Row]]]] = {}

    def of(self, source: str, columns: Sequence[str] | None) -> Iterable[JoinedScene]:
        """Return what :func:`joined_by_scene` yields, with at least the `columns` of the episodes; all if None."""
        if source not in self._few:
            told = self._told.get(source)
            if told is None and source in self._some:
                told = [*instructions_by_scene(self.tables, source)]
                self._told = {source: told}
            return joined_by_scene(self.tables, source, columns, told)
        if source not in self._kept:
            self._kept = {source: list(joined_by_scene(self.tables, source))}
        return self._kept[source]


def _choose(
    tables: SnapshotTables, config: ExportConfig, scenes: SceneTable
) -> tuple[Selection, SplitCodes, Generated]:
    builder = PoolBuilder(config.splits.max_tokens, statements=config.splits.statements == "even")
    counts: dict[str, int] = {}
    for source in tables.sources:
        builder.add_instructions(source, tables.batches("instructions", source, INSTRUCTION_COLUMNS))
        barred = scenes.barred(source)
        for batch in tables.batches("episodes", source, POOL_COLUMNS):
            builder.add_episodes(source, batch, barred)
            counts[source] = counts.get(source, 0) + batch.num_rows
    pool = builder.build()
    selection = select(pool, config.splits)
    ends = np.cumsum([counts.get(source, 0) for source in tables.sources])[:-1]
    splits_of = dict(zip(tables.sources, np.split(selection.split, ends), strict=True))
    return selection, splits_of, Generated.of(pool)


def _texts(rows: _JoinedRows, splits_of: SplitCodes, oracle_texts: OracleText | None) -> Iterator[str]:
    """Yield all texts of all splits, including the oracle twins."""
    for source, codes in splits_of.items():
        at = 0
        if oracle_texts is None:
            for batch in rows.tables.batches("episodes", source, ("instruction_text",)):
                texts = batch.column(0).to_pylist()
                yield from (text for text, code in zip(texts, codes[at:], strict=False) if code != OUT)
                at += len(texts)
            continue
        for _, episodes, instructions in rows.of(source, ORACLE_COLUMNS):
            for row in episodes:
                if codes[at] != OUT:
                    yield row["instruction_text"]
                    yield oracle_text_of(oracle_texts, row, instructions[row["instruction_id"]])
                at += 1
