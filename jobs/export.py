"""``condvln export``: the published snapshot as VLN-CE splits, ground truth and manifests."""

from __future__ import annotations

from collections.abc import Callable

from condvln.export.rows import Row
from condvln.export.scene_table import NavmeshBytes
from condvln.export.snapshot import ExportConfig, export_snapshot
from condvln.export.tables import FolderTables
from condvln.instructions import oracle_linear, render_moves, with_preamble
from condvln.instructions.config import COMPASS
from factory.snapshot import Snapshot
from jobs.pipeline import build_pipeline
from jobs.report import Report, Section
from jobs.workspace import published, snapshot_folder
from schemas.config import Config
from schemas.errors import ConfigError, CorruptShardError
from schemas.program import Program

__all__ = ["built_navmeshes", "export_snapshot_of", "run_export"]


def run_export(config: Config) -> Report:
    """Write the splits that the configuration asks for."""
    if config.export is None:
        raise ConfigError(
            "no export folder is named", place="export", remedy="Set export: FOLDER, or --set export=FOLDER."
        )
    return export_snapshot_of(config)


def export_snapshot_of(config: Config) -> Report:
    """Export what is published under the configuration's name."""
    assert config.export is not None
    snapshot = published(config)
    done = export_snapshot(
        FolderTables(snapshot_folder(config.store, snapshot)),
        config.export,
        ExportConfig(splits=config.splits, path_spacing=config.episodes.path_spacing),
        oracle_texts=_linear_text(config.seed, config.instructions.preamble),
        navmeshes=built_navmeshes(config, snapshot),
    )
    rows = [(split, len(done.scenes[split]), count) for split, count in done.episodes.items()]
    lines = [f"export of snapshot {snapshot.snapshot_id} in {config.export}"]
    if done.left_out:
        lines.append("left out: " + ", ".join(f"{n} {reason}" for reason, n in done.left_out.items()))
    return Report(done.document(), lines, [Section("Splits", ("split", "scenes", "episodes"), [*rows])])


def _linear_text(seed: int, opens: bool) -> Callable[[Row, Row], str]:
    """The gold branch of an instruction as a plain one, told with the same choices of words."""

    def text(episode: Row, instruction: Row) -> str:
        columns = {name: instruction[name] for name in ("category", "conditions", "branches", "leaves")}
        moves = oracle_linear(Program.model_validate(columns))
        told = render_moves(moves, seed, episode["instruction_id"])
        compass = any(move.qualifier is not None and move.qualifier.predicate in COMPASS for move in moves)
        return with_preamble(told, episode["start_heading_degrees"]) if opens and compass else told

    return text


def built_navmeshes(config: Config, snapshot: Snapshot) -> NavmeshBytes:
    """The navmeshes that the units of a snapshot were built with, by source and row of the scenes table."""
    pipeline = build_pipeline(config)

    def navmesh(source: str, row: Row) -> bytes | None:
        if not row["navmesh_built"]:
            return None
        try:
            kept = snapshot.unit_table(f"{source}/{row['scene_id']}", pipeline, "navmeshes")
        except CorruptShardError:
            return None  # the export bars the scene and says why
        return kept["data"][0].as_py() if kept.num_rows else None

    return navmesh
