"""Write a snapshot to an export folder: choose splits, write every variant, count everything.

An export has configuration files for the projects that run its episodes. The task files are complete: a project uses
one instead of its own task file. The files are templates in ``configs/``, one a file of the export. Paths assume that
the export is linked as ``data/datasets/condvln`` in the project's checkout, beside its ``data/scene_datasets``. Success
distances are set for SR, SPL, OSR and BSA; nDTW keeps R2R's 3 m. Keys follow VLN-CE's ``vlnce_task.yaml`` and
``rxr_vlnce_english_task.yaml``, habitat-lab's ``vln_r2r.yaml`` and the ANSR-v1 tasks of Open-Nav and VLN-Zero. What
differs from these:

* RxR has its own agent size, cameras and actions (turns of 30°), but the text sensor: its own sensor reads BERT
  features of each text from files, which an export does not have. The truth's path names the guide: with ``{role}`` in
  it, VLN-CE's nDTW opens a file for each of both roles, and an export has no followers.
* StreamVLN's file (``config/vln_r2r.yaml``, JanusVLN's too) and InternNav's (``scripts/eval/configs/vln_r2r.yaml``)
  are whole habitat-lab configurations. Without a package line, Hydra would put their keys below the folder's name.
  InternNav's agent also looks up and down by 15°; its actions are numbers in the order of the mapping, and its
  environment counts up to four looks around each step, so its limit of steps is ten times ours.
* Open-Nav's limit of 20 steps counts waypoint moves. Its experiment file has what its loop and its policy read beside
  the task (``run_OpenNav_gibson.yaml``): one process and one environment, since the loop follows the first one only.
* NaVid outputs angles, which its evaluator splits into turns of 30°; it reads VLN-CE's top-down map, which looks each
  scene up in a file of graphs. ``EARLY_STOP_…`` are the steps and consecutive turns after which its loop gives up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from condvln.bias import BiasGate
from condvln.export.card import croissant, dataset_card
from condvln.export.changelog import Generated, PublishedEpisodes, changes_between, with_entry
from condvln.export.contents import CHANGELOG, INDEX, document_digest, exported_snapshot
from condvln.export.pool import INSTRUCTION_COLUMNS, POOL_COLUMNS, PoolBuilder
from condvln.export.report import CardPicture, ExportReport, WrittenFile
from condvln.export.selection import OUT, Selection, select
from condvln.export.splits import SPLITS
from condvln.export.staging import staged
from condvln.export.tables import FolderTables, NavmeshBytes, Row, SceneTable, joined_by_scene
from condvln.export.tokens import Vocabulary
from condvln.export.viewpoints import Graphs
from condvln.export.vlnce import RXR_LANGUAGES
from condvln.export.writer import ExportWriter, OracleText
from condvln.formats.streams import atomic_stream, indented, write_file
from condvln.sources.family import composed_datasets
from schemas.config import SplitsConfig
from schemas.config.constants import STEP_CEILING
from schemas.errors import InputError, StoreError

__all__ = ["NavmeshBytes", "consumer_files", "export_snapshot"]

_AGENTS: Final = ("vlnce", "habitat_lab", "streamvln", "internnav", "open_nav", "vln_zero", "navid", "navila")
_VLNCE: Final = "vlnce/condvln_task.yaml"
_ORACLE: Final = "vlnce/condvln_oracle_task.yaml"
_FALLBACK_SUCCESS_DISTANCE: Final = 1.0


def consumer_files(report: ExportReport) -> dict[str, str]:
    """Return the text of each configuration file by path below the export."""
    radius, mixed = _success_distance(report)
    values = {
        "split": next((s for s in ("val_unseen", "test", "val_seen", "train") if report.episodes.get(s)), "val_unseen"),
        "radius": str(radius),
        "steps": str(report.most_steps or STEP_CEILING),
        "language": RXR_LANGUAGES[report.language],
        "variant": "vlnce",
    }
    other_distances = (
        f"# Some episodes have another success distance than {radius:g} m (info.success_distance);\n"
        "# `condvln evaluate` judges each by its own.\n"
    )
    composed = composed_datasets(scene for found in report.scenes.values() for scene in found)
    folder = files("condvln.export").joinpath("configs")
    templates = {
        f"{agent}/{file.name}": file.read_text(encoding="utf-8")
        for agent in _AGENTS
        for file in folder.joinpath(agent).iterdir()
    }
    templates["navila/condvln_task.yaml"] = templates[_VLNCE]
    if any("oracle/" in name for name in report.files):
        templates[_ORACLE] = templates[_VLNCE]
    texts = {}
    for path, template in sorted(templates.items()):
        root = "VLN_CE/" if path.startswith("vln_zero/") else ""
        in_parts = (
            f"# Of {', '.join(composed)}, which come in parts,\n"
            f"# `condvln export CONFIG --compose {root}data/scene_datasets/` puts every scene where its episodes name "
            "it.\n"
        )
        text = template.replace("$composed\n", in_parts if composed else "")
        text = text.replace("$mixed\n", other_distances if mixed else "")
        own = values | ({"variant": "oracle"} if path == _ORACLE else {})
        texts[f"configs/{path}"] = Template(text).substitute(own)
    return texts


def _success_distance(report: ExportReport) -> tuple[float, bool]:
    """Return the most frequent success distance, and whether other success distances occur."""
    counts: dict[str, int] = {}
    for split in SPLITS:
        for value, count in report.shapes.get(split, {}).get("success_distance", {}).items():
            counts[value] = counts.get(value, 0) + count
    if not counts:
        return _FALLBACK_SUCCESS_DISTANCE, False
    return float(max(sorted(counts), key=lambda value: counts[value])), len(counts) > 1


Complete = Callable[[Path, ExportReport], None]
"""Called with the new files and their report before they replace the former export."""

Pictures = Callable[[Path], Iterable[CardPicture]]
"""Called with the new folder after the manifests are written; returns the pictures of the dataset card."""

_TEXT_COLUMNS: Final = (
    "scene_id",
    "episode_id",
    "instruction_id",
    "gold_leaf",
    "start_heading_degrees",
    "instruction_text",
)
"""Columns of an episode from which the texts of its variants are made."""

SplitCodes = dict[str, npt.NDArray[np.int8]]
"""By source, the split code of each row of the episodes table in reading order."""


def export_snapshot(
    tables: FolderTables,
    out: Path,
    splits: SplitsConfig | None = None,
    *,
    texts: Mapping[str, Any] | None = None,
    oracle_text: OracleText | None = None,
    navmeshes: NavmeshBytes | None = None,
    graphs: Graphs | None = None,
    former: FolderTables | None = None,
    pictures: Pictures | None = None,
    complete: Complete | None = None,
) -> ExportReport:
    """Write all splits of a snapshot, one scene in memory at a time.

    The export is written beside ``out`` and replaces it atomically (``condvln.export.staging``);
    one process at a time may write an ``out``. The user's own files in ``out`` are kept. ``export.json`` lists all
    files with their hashes. The same snapshot and configuration give the same bytes (``CHANGELOG.md`` aside, the
    history of the folder).

    Parameters
    ----------
    texts : the settings with which the texts were rendered: ``seed``, ``preamble``, ``language``, ``voices``,
        ``length``
    oracle_text : makes the linear texts of the oracle twin; without it no twin is written
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
    splits = splits or SplitsConfig()
    report = ExportReport(tables.id, dict(texts or {}))
    with staged(out) as new:
        scenes = SceneTable(tables, navmeshes)
        selection, splits_of, generated = _choose(tables, splits, scenes)
        report.cells = selection.cells
        report.left_out = dict(sorted(selection.left_out.items()))
        report.lost = {name: dict(found) for name, found in sorted(selection.lost.items())}
        report.empty_splits = {str(split): why for split, why in selection.empty.items()}
        report.truth_imbalance = selection.truth_imbalance
        vocabulary = Vocabulary.of(_texts(tables, splits_of, oracle_text))
        report.vocabulary = len(vocabulary.words)
        report.episodes = dict.fromkeys(SPLITS, 0)
        report.scenes = {split: [] for split in SPLITS}
        published, before = _formerly(out, exported_snapshot(out), tables.id, former, splits)
        gate = BiasGate() if splits.bias != "off" else None
        writer = ExportWriter(
            new,
            vocabulary,
            scenes,
            report,
            sharded=splits.sharded,
            oracle_text=oracle_text,
            graphs=graphs,
            show=None if gate is None else gate.add,
        )
        with writer.open():
            for source, scene, chosen in _chosen(tables, splits_of):
                writer.add_scene(source, scene, chosen)
        if gate is not None:
            report.bias = gate.report()
        for picture in pictures(new) if pictures is not None else ():
            _write(new, picture.path, picture.data, report)
            report.pictures[picture.path] = picture.caption
        # The card, the metadata and the configuration files only restate the report.
        for path, text in (consumer_files(report) | {"README.md": dataset_card(report)}).items():
            _write(new, path, text.encode(), report)
        _write(new, "croissant.json", indented(croissant(report)), report)
        _write_changelog(out, new, published, before, generated)
        if complete is not None:
            complete(new, report)
        document = report.document()
        document["digest"] = document_digest(document)
        write_file(new / INDEX, indented(document))
    return report


def _chosen(
    tables: FolderTables, splits_of: SplitCodes, columns: Sequence[str] | None = None
) -> Iterator[tuple[str, str, list[tuple[int, Row, Row]]]]:
    """Yield (source, scene, episodes that are in a split) for each scene that has some; an episode as its split code,
    its row, with all columns unless `columns` is given, and the row of its instruction.
    """
    for source, codes in splits_of.items():
        at = 0
        for scene, episodes, instructions in joined_by_scene(tables, source, columns):
            here = codes[at : at + len(episodes)].tolist()
            at += len(episodes)
            chosen = [
                (code, row, instructions[row["instruction_id"]])
                for code, row in zip(here, episodes, strict=True)
                if code != OUT
            ]
            if chosen:
                yield source, scene, chosen


def _write(out: Path, path: str, data: bytes, report: ExportReport) -> None:
    with atomic_stream(out / path) as stream:
        stream.write(data)
    report.files[path] = WrittenFile(stream.size, stream.digest.hexdigest())


def _formerly(
    out: Path, exported: str, now: str, former: FolderTables | None, splits: SplitsConfig
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
        _, splits_of, generated = _choose(former, splits, SceneTable(former, None))
        if published is None:
            rows = (
                (SPLITS[code], source, row)
                for source, _, chosen in _chosen(former, splits_of)
                for code, row, _ in chosen
            )
            published = PublishedEpisodes.of_rows(former.id, rows)
    # the former snapshot has no episodes or is damaged; the new one is exported all the same
    except (StoreError, InputError):
        return published, None
    return published, generated


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
        write_file(new / CHANGELOG, text.encode())


def _choose(tables: FolderTables, splits: SplitsConfig, scenes: SceneTable) -> tuple[Selection, SplitCodes, Generated]:
    builder = PoolBuilder(splits.max_tokens, statements=splits.statements == "even")
    counts: dict[str, int] = {}
    for source in tables.sources:
        builder.add_instructions(source, tables.batches("instructions", source, INSTRUCTION_COLUMNS))
        barred = scenes.barred(source)
        for batch in tables.batches("episodes", source, POOL_COLUMNS):
            builder.add_episodes(source, batch, barred)
            counts[source] = counts.get(source, 0) + batch.num_rows
    pool = builder.build()
    selection = select(pool, splits)
    ends = np.cumsum([counts.get(source, 0) for source in tables.sources])[:-1]
    splits_of = dict(zip(tables.sources, np.split(selection.split, ends), strict=True))
    return selection, splits_of, Generated.of(pool)


def _texts(tables: FolderTables, splits_of: SplitCodes, oracle_text: OracleText | None) -> Iterator[str]:
    """Yield all texts of all splits, including the oracle twins."""
    for _, _, chosen in _chosen(tables, splits_of, _TEXT_COLUMNS):
        for _, row, instruction in chosen:
            yield row["instruction_text"]
            if oracle_text is not None:
                yield oracle_text(row, instruction)
