"""``condvln export``: the published snapshot as VLN-CE splits, ground truth and manifests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
from PIL import Image

from condvln.export.contents import ORIGIN, exported_snapshot
from condvln.export.report import CardPicture, ExportReport
from condvln.export.snapshot import NavmeshBytes, export_snapshot
from condvln.export.staging import alone_in, staged
from condvln.export.tables import FolderTables, Row
from condvln.export.viewpoints import FOLDER, GraphEpisodes, ViewpointReport, write_viewpoints
from condvln.formats.streams import write_file
from condvln.instructions import oracle_linear
from condvln.instructions.programs import program_tree
from condvln.manifest import ManifestLine, manifest_lines, manifest_paths, published_row
from condvln.navigation.graph_pathfinder import GraphFolder
from condvln.navigation.navmesh_file import parse_navmesh
from condvln.scene.tables import scene_from_tables
from condvln.sources.family import FAMILIES
from factory.snapshot import Snapshot, read_manifest, read_ref, ref_path
from jobs.bias import add_bias, priors_behind
from jobs.export_origin import Origin, refuse_losses, remember_data
from jobs.funnel import listed
from jobs.oracle import text_of_moves
from jobs.pipeline import built_navmeshes, listed_units
from jobs.report import Report, Section
from jobs.settings import export_folder
from jobs.workspace import graph_folders, published, snapshot_folder
from schemas.config import Config, WordingConfig
from schemas.errors import CondVLNError, CorruptShardError, SmallerExportError, StoreError
from schemas.evaluation import ManifestEpisode
from schemas.program import CATEGORIES, Program

__all__ = ["alone_in_export", "card_pictures", "graphs_of", "run_export", "write_export"]


PICTURES: Final = "pictures"
COLOURS: Final = 64
"""Number of colours of the dataset card's pictures, which are a tenth of a small pack."""
LOOKED_AT: Final = 40
"""Number of a source's first episodes among which the one with most leaves is drawn on the dataset card."""

_COMPARED: Final = ("episodes", "instructions", "scenes")


def run_export(config: Config, *, allow_shrink: bool = False) -> Report:
    """Write the splits that the configuration asks for.

    allow_shrink : also where the export would hold fewer episodes than the one in place, whatever the reason

    Raises
    ------
    SmallerExportError : it would hold fewer episodes than the export in place, which is kept
    StoreError : the disk refused, or another command is writing the folder
    """
    export_folder(config)
    with alone_in_export(config):
        report = write_export(config, allow_shrink=allow_shrink)
    if not report.document:
        report.exit_code = SmallerExportError.exit_code
    return report


def alone_in_export(config: Config) -> AbstractContextManager[None]:
    """Hold the lock of the configured export folder for a whole run; without such a folder, do nothing.

    Raises
    ------
    StoreError : another command holds it, or an export can't be written there
    """
    return nullcontext() if config.export is None else alone_in(config.export)


def write_export(config: Config, *, allow_shrink: bool = False, renewed: bool = False) -> Report:
    """Export as :func:`run_export` does, for a caller that already holds the lock (:func:`alone_in_export`).

    renewed : the priors were renewed on purpose
    """
    snapshot, out = published(config), export_folder(config)
    guard = _Guard(config, snapshot, allow_shrink, renewed)
    if not snapshot.manifest.tables["episodes"].rows:
        return _viewpoints_alone(config, snapshot, guard)
    viewpoints = ViewpointReport()

    def complete(new: Path, report: ExportReport) -> None:
        nonlocal viewpoints
        _check_rows(snapshot, report)
        guard.check(report.episodes, report.left_out)
        guard.record(new)
        viewpoints = _write_viewpoints(config, snapshot, new)
        report.files |= viewpoints.files

    wording = config.instructions.wording
    texts = {"seed": config.seed, "preamble": config.text.preamble, **wording.model_dump(mode="json")}
    tables, navmeshes = FolderTables(snapshot_folder(config.store, snapshot)), built_navmeshes(config, snapshot)
    done = export_snapshot(
        tables,
        out,
        config.splits,
        texts=texts,
        oracle_text=_linear_text(config.seed, config.text.preamble, wording),
        navmeshes=navmeshes,
        graphs=graphs_of(config),
        former=_former(config, snapshot),
        pictures=partial(card_pictures, tables, navmeshes),
        complete=complete,
    )
    rows = [(split, len(done.scenes[split]), count) for split, count in done.episodes.items()]
    lines = [f"export of snapshot {snapshot.snapshot_id} in {out}", *guard.said, *_left_out(done)]
    categories = _categories(done, snapshot)
    lines += _lost_categories(categories)
    columns = ("category", "wanted (without groups)", "placed", "kept", "left out")
    sections = [Section("Splits", ("split", "scenes", "episodes"), [*rows]), Section("Categories", columns, categories)]
    if short := done.shortfalls:
        missing = sum(cell.shortfall for cell in short)
        lines.append(f"{len(short)} cells are short, by {missing} episodes together: the export's README.md lists them")
    report = Report(done.document(), lines, sections)
    if guard.said:
        report.document["smaller"] = guard.said
    if not sum(done.episodes.values()):
        report.exit_code = SmallerExportError.exit_code
    failed = done.bias is not None and not done.bias.passed
    behind = priors_behind(snapshot, config.name) if failed else None
    add_bias(report, done.bias, config.splits.bias, behind, config.splits.statements)
    _add_viewpoints(report, config, viewpoints)
    remember_data(out, {source.family: source.root for source in config.sources})
    return report


def _check_rows(snapshot: Snapshot, report: ExportReport) -> None:
    """Check the count of episodes: those in splits and those left out for a reason must add up to the number of
    episodes in the snapshot's manifest.
    """
    found = sum(report.episodes.values()) + sum(report.left_out.values())
    rows = snapshot.manifest.tables["episodes"].rows
    if found != rows:
        raise CorruptShardError(
            f"the table episodes has {found} rows, but the manifest says {rows}",
            where=f"{snapshot.store.url}/snapshots/{snapshot.snapshot_id}",
            remedy="Run condvln generate CONFIG --verify, which rebuilds the missing files.",
        )


def _categories(done: ExportReport, snapshot: Snapshot) -> list[Sequence[Any]]:
    """Return a row for each category: its name, how many episodes were wanted (of no category for counterfactual
    groups), placed in scenes and kept, and why the others were left out.
    """
    sums = snapshot.table("funnel", ["category", "wanted"]).group_by("category").aggregate([("wanted", "sum")])
    wanted = Counter({row["category"]: row["wanted_sum"] for row in sums.to_pylist()})
    kept = sum((Counter(shape.get("category", {})) for shape in done.shapes.values()), Counter[str]())
    lost = {name: Counter(done.lost.get(name, {})) for name in CATEGORIES}
    placed = {name: kept[name] + lost[name].total() for name in CATEGORIES}
    names = (name for name in CATEGORIES if wanted[name] or placed[name])
    return [(name, wanted[name], placed[name], kept[name], listed(lost[name])) for name in names]


def _lost_categories(categories: Sequence[Sequence[Any]]) -> list[str]:
    """Return a warning for each category of which nothing is kept: why, and what can be done."""
    why = (
        "left out: {}. A split keeps a category of a source only with an episode of every gold leaf: use more scenes, "
        "a larger instructions.per_category, or fewer splits (splits.fractions)"
    )
    none = "condvln status CONFIG says what rejected the candidates; use more or larger scenes"
    return [
        f"WARNING: no episode of {name} is in a split: {wanted} wanted, {placed} placed, 0 kept; "
        + (why.format(reasons) if placed else none)
        for name, wanted, placed, kept, reasons in categories
        if not kept
    ]


def _left_out(done: ExportReport) -> list[str]:
    """Return lines about splits that stayed empty or are lopsided, and about episodes that are in no split, with the
    reasons.
    """
    chosen, left = sum(done.episodes.values()), sum(done.left_out.values())
    lines = [f"note: split {split} has no episodes: {why}" for split, why in done.empty_splits.items()]
    lines += [
        f"WARNING: split {split} is lopsided: {what}; splits.scenes gives it more scenes"
        for split, what in done.lopsided.items()
    ]
    if not chosen:
        lines.insert(0, "WARNING: the export holds no episodes")
    if left:
        reasons = "; ".join(f"{count} {reason}" for reason, count in done.left_out.items())
        lines.append(f"{left} of {chosen + left} episodes are in no split: {reasons}")
    return lines


class _Guard:
    """Compares a new export with the one that it would replace, and records what the new export is made of."""

    def __init__(self, config: Config, snapshot: Snapshot, allow_shrink: bool, renewed: bool) -> None:
        self._config = config
        self._origin = Origin.of(config, snapshot)
        self._ref = f"{snapshot.store.url}/{ref_path(config.name)}"
        self._allow = allow_shrink
        self._renewed = renewed
        self.said: list[str] = []

    def check(self, episodes: Mapping[str, int], left_out: Mapping[str, int]) -> None:
        """Raise the error of :func:`refuse_losses` if the export lost episodes without a reason, unless
        ``--allow-shrink`` is given.
        """
        try:
            self.said = refuse_losses(
                export_folder(self._config),
                self._ref,
                self._origin,
                episodes,
                left_out,
                renewed=self._renewed,
                listed=self._listed,
            )
        except SmallerExportError as error:
            if not self._allow:
                raise
            self.said = [f"allowed by --allow-shrink: {error.what}"]

    def record(self, new: Path) -> None:
        """Write the record of what the export is made of."""
        write_file(new / ORIGIN, self._origin.as_bytes())

    def _listed(self) -> set[str] | None:
        """Return the scenes that the sources have now; None where the sources can't be listed, as on a machine without
        them.
        """
        try:
            return {unit.unit_id for unit in listed_units(self._config)}
        except (CondVLNError, OSError):
            return None


def _viewpoints_alone(config: Config, snapshot: Snapshot, guard: _Guard) -> Report:
    """Export a snapshot without episodes on a navmesh: only what can be placed on viewpoint graphs, if anything."""
    report = Report({}, ["no episodes on a navmesh to export; the tables scenes and rejections say why"])
    graphs = graphs_of(config)
    if not graphs:
        guard.check({}, {})
        return report
    with staged(export_folder(config)) as new:
        guard.check({}, {})
        guard.record(new)
        viewpoints = _write_viewpoints(config, snapshot, new)
    report.lines += guard.said
    _add_viewpoints(report, config, viewpoints)
    return report


def _write_viewpoints(config: Config, snapshot: Snapshot, new: Path) -> ViewpointReport:
    """Place the instructions of scans without a mesh on their viewpoint graphs, if there are any."""
    graphs = graphs_of(config)
    if not graphs:
        return ViewpointReport()
    tables = FolderTables(snapshot_folder(config.store, snapshot))
    said = config.instructions.wording
    episodes = GraphEpisodes(tables, graphs, config.splits, config.seed, config.text.preamble, said)
    return write_viewpoints(new, episodes, snapshot.snapshot_id, episodes.left_out)


def _add_viewpoints(report: Report, config: Config, done: ViewpointReport) -> None:
    if done.episodes or done.left_out:
        report.document["viewpoints"] = done.document()
        made = ", ".join(f"{count} {split}" for split, count in done.episodes.items()) or "none"
        refused = ", ".join(f"{count} {reason}" for reason, count in done.left_out.items()) or "none"
        report.lines.append(f"on viewpoints alone, in {export_folder(config) / FOLDER}: {made}; left out: {refused}")


def _linear_text(seed: int, preamble: bool, wording: WordingConfig) -> Callable[[Row, Row], str]:
    def text(episode: Row, instruction: Row) -> str:
        named = {name: instruction[name] for name in ("category", "conditions", "branches", "leaves")}
        moves = oracle_linear(Program.model_validate(named))
        heading = episode["start_heading_degrees"]
        return text_of_moves(moves, episode["instruction_id"], heading, wording, seed=seed, preamble=preamble)

    return text


def _former(config: Config, snapshot: Snapshot) -> FolderTables | None:
    """Return the snapshot that the export in the folder was made of or, without an export, the one published before
    `snapshot`; None if the store no longer holds it.
    """
    ref, _ = read_ref(snapshot.store, config.name)
    states = [state for state in (ref.history if ref is not None else ()) if state.snapshot_id != snapshot.snapshot_id]
    exported = exported_snapshot(config.export) if config.export is not None else ""
    if exported:
        states = [state for state in states if state.snapshot_id == exported]
    if not states or snapshot.store.local_path("snapshots") is None:  # not worth fetching for a changelog
        return None
    manifest = read_manifest(snapshot.store, states[0].snapshot_id)
    if manifest is None or any(
        name not in manifest.tables or manifest.tables[name].columns != snapshot.manifest.tables[name].columns
        for name in _COMPARED
    ):
        return None
    try:
        folder = snapshot_folder(config.store, Snapshot(snapshot.store, manifest, states[0].index), _COMPARED)
    except StoreError:
        return None
    return FolderTables(folder)


def graphs_of(config: Config) -> GraphFolder:
    """Return the connectivity graphs of Matterport3D scans, from the configured or the dataset's own folder."""
    return GraphFolder(*graph_folders(config))


def card_pictures(tables: FolderTables, navmeshes: NavmeshBytes, export: Path) -> Iterator[CardPicture]:
    """Yield a picture for each source of an export. The pictures depend on the snapshot alone: navmeshes that belong to
    a dataset are not drawn, since the dataset may be missing on this machine. Sources whose terms forbid passing on
    images get no picture.

    Parameters
    ----------
    export : the new folder, in which the manifests are written
    """
    import matplotlib

    from condvln.episodes.picture import draw_episode

    for source, row in sorted(_chosen(export, set(tables.sources)).items()):
        scene_id = row.scene_id
        own = {name: _rows(tables, name, source, scene_id) for name in ("scenes", "rooms", "objects")}
        scene = scene_from_tables(own, Path(), family=source)
        data = navmeshes(source, own["scenes"].to_pylist()[0])
        floor = () if data is None else parse_navmesh(data, scene_id).tile.outlines()
        with TemporaryDirectory() as folder, matplotlib.rc_context({"text.parse_math": False}):
            path = Path(folder, f"{source}.png")
            draw_episode(path, scene, floor, published_row(row), program_tree(row.program), program=row.program)
            with Image.open(path) as image, BytesIO() as small:
                image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
                drawn = small.getvalue()
        caption = f"{source}, scene {scene_id}, episode {row.episode_id}: “{row.instruction_text}”"
        yield CardPicture(f"{PICTURES}/{path.name}", caption, drawn)


def _chosen(export: Path, sources: set[str]) -> dict[str, ManifestEpisode]:
    """Return the episode to draw for each source: of the source's first `LOOKED_AT` episodes, the one with the most
    leaves.
    """
    wanted = {source for source in sources if source in FAMILIES and not FAMILIES[source].licensed}
    found: dict[str, list[tuple[int, ManifestLine]]] = {source: [] for source in wanted}
    lines = (line for path in manifest_paths(export) for line in manifest_lines(path))
    for line in lines:
        fields = line.fields()
        source = fields.get("source")
        if source in found and len(found[source]) < LOOKED_AT:
            found[source].append((len(fields["leaves"]), line))
            if all(len(rows) == LOOKED_AT for rows in found.values()):
                break
    chosen = {source: max(rows, key=itemgetter(0))[1] for source, rows in found.items() if rows}
    return {source: line.row() for source, line in chosen.items()}


def _rows(tables: FolderTables, name: str, source: str, scene_id: str) -> pa.Table:
    """Return the rows of one scene."""
    kept: Sequence[pa.RecordBatch] = [
        batch.filter(pc.equal(batch["scene_id"], scene_id)) for batch in tables.batches(name, source)
    ]
    return pa.Table.from_batches(kept)
