"""``condvln export``: the published snapshot as VLN-CE splits, ground truth and manifests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypedDict

from condvln.export.graph_episodes import GraphEpisodes
from condvln.export.graphs import GraphFolder
from condvln.export.rows import Row
from condvln.export.snapshot import ExportConfig, export_snapshot, exported_snapshot
from condvln.export.tables import FolderTables
from condvln.export.viewpoints import FOLDER, write_viewpoints
from factory.snapshot import Snapshot, read_manifest, read_ref
from jobs.bias import add_bias, priors_behind
from jobs.built_navmeshes import built_navmeshes
from jobs.export_lock import alone_in
from jobs.oracle import linear_text
from jobs.report import Report, Section
from jobs.workspace import graph_folders, published, snapshot_folder
from schemas.config import Config
from schemas.errors import ConfigError, StoreError
from schemas.program import Program

__all__ = ["add_viewpoints", "export_snapshot_of", "graphs_of", "run_export"]


_COMPARED: Final = ("episodes", "instructions", "scenes")
_PROGRAM: Final = ("category", "conditions", "branches", "leaves")


class _Texts(TypedDict):
    """What decides the words of an instruction besides its program."""

    seed: int
    preamble: bool


def run_export(config: Config) -> Report:
    """Write the splits that the configuration asks for."""
    if config.export is None:
        raise ConfigError(
            "no export folder is named", place="export", remedy="Set export: FOLDER, or --set export=FOLDER."
        )
    return export_snapshot_of(config)


def export_snapshot_of(config: Config) -> Report:
    """Export what is published under the configuration's name.

    Raises
    ------
    StoreError : the disk refused, or another export is writing the folder
    """
    assert config.export is not None
    with alone_in(config.export):
        return _export(config)


def _export(config: Config) -> Report:
    assert config.export is not None
    snapshot = published(config)
    texts = _Texts(seed=config.seed, preamble=config.instructions.preamble)
    done = export_snapshot(
        FolderTables(snapshot_folder(config.store, snapshot)),
        config.export,
        ExportConfig(
            splits=config.splits,
            path_spacing=config.episodes.path_spacing,
            sharded=config.splits.sharded,
            texts=texts,
        ),
        oracle_texts=_linear_text(**texts),
        navmeshes=built_navmeshes(config, snapshot),
        graphs=graphs_of(config),
        former=_former(config, snapshot),
    )
    rows = [(split, len(done.scenes[split]), count) for split, count in done.episodes.items()]
    lines = [f"export of snapshot {snapshot.snapshot_id} in {config.export}"]
    if done.left_out:
        lines.append("left out: " + ", ".join(f"{n} {reason}" for reason, n in done.left_out.items()))
    sections = [Section("Splits", ("split", "scenes", "episodes"), [*rows])]
    if done.shortfalls:
        short = [(c.split, c.source, c.category, c.gold_leaf, c.wanted, c.selected) for c in done.shortfalls]
        lines.append(f"{len(short)} cells are short, by {sum(c.shortfall for c in done.shortfalls)} episodes together")
        columns = ("split", "source", "category", "gold leaf", "wanted", "selected")
        sections.append(Section("Cells that are short", columns, [*short]))
    report = Report(done.document(), lines, sections)
    failed = done.bias is not None and not done.bias.passed
    add_bias(report, done.bias, config.splits.bias, priors_behind(snapshot, config.name) if failed else None)
    add_viewpoints(report, config, snapshot)
    return report


def add_viewpoints(report: Report, config: Config, snapshot: Snapshot) -> None:
    """Place the instructions of scans without a mesh on their viewpoint graphs, where there are such, and say so."""
    assert config.export is not None
    graphs = graphs_of(config)
    if not graphs:
        return
    tables = FolderTables(snapshot_folder(config.store, snapshot))
    episodes = GraphEpisodes(tables, graphs, config.splits, config.seed, config.instructions.preamble)
    done = write_viewpoints(config.export, episodes, snapshot.snapshot_id, episodes.left_out)
    if done.episodes or done.left_out:
        report.document["viewpoints"] = done.document()
        made = ", ".join(f"{count} {split}" for split, count in done.episodes.items()) or "none"
        refused = ", ".join(f"{count} {reason}" for reason, count in done.left_out.items()) or "none"
        report.lines.append(f"on viewpoints alone, in {config.export / FOLDER}: {made}; left out: {refused}")


def _linear_text(seed: int, preamble: bool) -> Callable[[Row, Row], str]:
    def text(episode: Row, instruction: Row) -> str:
        program = Program.model_validate({name: instruction[name] for name in _PROGRAM})
        heading = episode["start_heading_degrees"]
        return linear_text(program, episode["instruction_id"], heading, seed=seed, preamble=preamble)

    return text


def _former(config: Config, snapshot: Snapshot) -> FolderTables | None:
    """The snapshot that the folder's export was made of, else the one published before; None where it is not kept."""
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
    """Connectivity of Matterport3D scans, where the configuration names it or the dataset's folder holds it."""
    return GraphFolder(*graph_folders(config))
