"""``condvln trajectories``: make training data in the agents' own layouts. Each scene is one task, a stopped run can be
resumed, and tables and layouts are written from the run's published snapshot.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import orjson
from rich.console import Console

from condvln.formats.image_files import encoders
from condvln.formats.streams import atomic_stream
from condvln.manifest import manifest_lines, manifest_path
from condvln.sensors.textures import decoders
from condvln.trajectories.cameras import Cameras, hub_cameras
from condvln.trajectories.hub import ANNOTATIONS, SceneWalks, write_hub, write_tables
from condvln.trajectories.images import IMAGES, clear_parts, clear_walks
from condvln.trajectories.internvla import internvla_n1
from condvln.trajectories.layouts import AddScene, Layout, janusvln, link, navila, new_folder
from condvln.trajectories.lerobot import lerobot
from condvln.trajectories.licences import licences, read_me, refuse_unlicensed
from condvln.trajectories.recipe import RECIPE_FILES, RECORD, Recipe
from condvln.trajectories.uninavid import uninavid
from factory.commits import Commits
from factory.files import FileHashes
from factory.local_store import LocalStore
from factory.pipeline import Pipeline, TableSpec
from factory.report import ABORTED
from factory.run import run
from factory.snapshot import Snapshot
from factory.stage import Stage
from factory.unit import Unit
from jobs.compose import refuse_export
from jobs.generate import CompilationNote, open_executor, run_report
from jobs.progress import LoggedRun, RunProgress
from jobs.report import Report
from jobs.stages.trajectories import FrameStage, RecipeStage, WalkStage
from jobs.store_lock import alone
from jobs.trajectory_images import forget_damaged
from jobs.trajectory_notes import note_lines, scene_notes
from jobs.trajectory_progress import Speed, plan_lines
from jobs.trajectory_recipe import Comparison, encoder_lines, recipe_target, recipe_units, scene_files
from jobs.trajectory_request import STATE, Request, refuse_links, refuse_strangers, trajectory_config
from jobs.trajectory_units import Target, estimate, find_target, list_units
from jobs.workspace import git_revision, hasher
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import StoreError, UsageError
from schemas.trajectory_tables import TRAJECTORY_SORT_KEYS, TRAJECTORY_TABLES
from schemas.version import SCHEMA_VERSION

__all__ = ["LAYOUTS", "RECORD", "WRITTEN", "Request", "make_trajectories", "trajectory_config"]

_VIEWS: Final[Mapping[str, Layout]] = {"navila": navila, "uninavid": uninavid, "janusvln": janusvln}
"""Layouts that need the main camera only."""

_OF_ALL_CAMERAS: Final[Mapping[str, Callable[[Path, str, Cameras], AbstractContextManager[AddScene]]]] = {
    "internvla-n1": internvla_n1,
    "lerobot": lerobot,
}
"""Layouts that take further cameras."""

LAYOUTS: Final = ("streamvln", *_VIEWS, *_OF_ALL_CAMERAS)
"""Names of the layouts. The first one is the hub, which is always written."""

RECIPE: Final = "recipe"
"""Folder with links to the files of the recipe, so that they can be passed on without the images."""

WRITTEN: Final = (*RECIPE_FILES, ANNOTATIONS, RECIPE, *LAYOUTS[1:], f"navila/{ANNOTATIONS}")
"""Files and folders that are written under another name until they are complete, beside the folders of images."""

REF: Final = "trajectories"

KERNELS: Final = ("paths", "follower", "cameras", "depth images", "pixel goals")
"""Groups of kernels that walks and images need (``jobs.warm_up``)."""

_STAGE_OF: Final = {"trajectories": "walks", "left_out": "walks", "poses": "frames"}
_LIBRARIES: Final = ("isal", "numba", "numpy", "pillow", "pyarrow", "simplejpeg")
"""Libraries whose versions may change images or tables."""


def make_trajectories(request: Request, console: Console | None = None) -> Report:
    """Make the walks of a split's episodes, the images along the walks, and the requested layouts, whose files refer to
    the images.

    Raises
    ------
    UsageError : an unknown layout, camera or split; the folder holds other files, or is the export's
    StoreError : another run uses the folder, or the disk refuses
    """
    unknown = sorted(set(request.layouts) - set(LAYOUTS))
    if unknown:
        raise UsageError(
            f"there is no layout {unknown[0]!r}", place="--layout", remedy=f"Choose among {', '.join(LAYOUTS)}."
        )
    console = console or Console(stderr=True)
    folder = request.out.resolve()
    refuse_strangers(folder)
    refuse_links(folder, (IMAGES, RECIPE, *LAYOUTS[1:]))
    if request.recipe_only and (folder / IMAGES).exists():
        raise UsageError("the folder has images", where=folder, place="--recipe-only", remedy="Name another folder.")
    state = folder / STATE
    hashes = FileHashes(state / ".hashes.sqlite" if state.is_dir() else None)
    work = _recipe_work(request, hashes) if request.recipe is not None else _export_work(request, hashes)
    hashes.save()
    refuse_export(work.target.export, folder)
    expected = estimate(work.units, work.cameras, work.layouts, keep=not request.recipe_only)
    lines = plan_lines(expected, folder) + ([] if work.recipe is None else encoder_lines(work.recipe))
    if request.plan:
        return Report({"plan": asdict(expected)}, lines)
    for line in lines:
        console.print(line, highlight=False, markup=False)
    with alone(state, REF) as held:
        if not held:
            raise StoreError(
                "another run writes to this folder",
                where=folder,
                remedy="Wait until it is done, or name another folder.",
            )
        return _Run(request, work, folder, console).go()


@dataclass(frozen=True)
class _Work:
    """The work of a run: the scenes as units, the cameras, the layouts, and the configuration of walks and images."""

    target: Target
    config: TrajectoryConfig
    cameras: Mapping[str, CameraConfig]
    layouts: tuple[str, ...]
    units: list[Unit]
    walks: Stage
    recipe: Recipe | None = None


def _refuse_unlicensed(request: Request, families: Iterable[str]) -> None:
    if not (request.licensed or request.recipe_only or request.plan):
        refuse_unlicensed(families)


def _export_work(request: Request, hashes: FileHashes) -> _Work:
    target = find_target(request.target, request.split, request.scenes, request.roots, request.overrides)
    lines = manifest_lines(manifest_path(target.export, target.split))
    _refuse_unlicensed(request, (str(line.fields().get("source")) for line in lines))
    cameras = hub_cameras(request.camera, request.layouts, request.sweep)
    config = request.config
    units = list_units(target, cameras, config, hasher(hashes))
    stage = WalkStage(config, target.texts if "oracle" in config.walks else None, target.config.limits)
    return _Work(target, config, cameras, request.layouts, units, stage)


def _recipe_work(request: Request, hashes: FileHashes) -> _Work:
    assert request.recipe is not None
    recipe = Recipe(request.recipe.resolve())
    _refuse_unlicensed(request, (family for family, _ in recipe.scenes))
    target = recipe_target(recipe, request.scenes)
    record = recipe.record
    layouts = tuple(name for name in record.layouts if name in LAYOUTS) or ("streamvln",)
    units = recipe_units(recipe, target, hasher(hashes))
    return _Work(target, record.config, record.cameras, layouts, units, RecipeStage(recipe.folder), recipe)


@dataclass
class _Run:
    request: Request
    work: _Work
    folder: Path
    console: Console

    def go(self) -> Report:
        state = self.folder / STATE
        store = LocalStore(state)
        clear_parts(self.folder, WRITTEN)
        pipeline = self._pipeline(state)
        forget_damaged(store, self.folder, state)
        ray = self.work.target.config.ray
        if self.request.workers is not None:
            ray = ray.model_copy(update={"workers": self.request.workers})
        with (
            RunProgress(self.console) as bar,
            LoggedRun(store, state, Speed(bar, Commits(store), self.console)) as log,
            open_executor(ray, self.request.inline, bar.note, KERNELS, CompilationNote(self.console)) as executor,
        ):
            done = run(
                pipeline,
                self.work.units,
                store,
                REF,
                executor,
                budget=ray.max_failures,
                progress=log.progress,
                retry_quarantined=self.request.retry,
                memory=None if ray.memory_gib is None else int(ray.memory_gib * 2**30),
                revision=git_revision(),
            )
            log.keep(done)
        report = run_report(done)
        if done.exit_code != ABORTED and done.snapshot_id is not None:
            counts = self._assemble(Snapshot.open(store, REF), pipeline, report)
            report.document |= counts
            report.lines += note_lines(counts["notes"])
            report.lines.append(
                f"{counts['trajectories']:,} walks of {counts['episodes']:,} episodes, {counts['images']:,} images, "
                f"{counts['stored_bytes'] / 1e9:.2f} GB in {self.folder}"
            )
            if counts["left_out"]:
                report.lines.append(f"{counts['left_out']:,} walks left out: see left_out.parquet")
        return report

    def _pipeline(self, state: Path) -> Pipeline:
        work = self.work
        limits = work.target.config.limits
        frames = FrameStage(self.folder, state, work.cameras, work.config, limits, keep=not self.request.recipe_only)
        return Pipeline(
            name="trajectories",
            stages=(work.walks, frames),
            tables={
                name: TableSpec(schema, TRAJECTORY_SORT_KEYS[name], _STAGE_OF[name])
                for name, schema in TRAJECTORY_TABLES.items()
            },
        )

    def _assemble(self, snapshot: Snapshot, pipeline: Pipeline, report: Report) -> dict[str, Any]:
        """Write the tables and layouts from the snapshot and, last, the record of the run; return the counts."""
        counts = {
            "trajectories": 0,
            "episodes": 0,
            "frames": 0,
            "images": 0,
            "bytes": 0,
            "stored_bytes": 0,
            "left_out": 0,
        }
        kinds: dict[str, int] = {}
        kept: set[str] = set()
        work = self.work
        keep = not self.request.recipe_only
        compared = None if work.recipe is None else Comparison(work.recipe)
        with ExitStack() as stack:
            adds = [stack.enter_context(view) for view in self._views()] if keep else []
            if compared is not None:
                adds.append(compared.add)
            write = write_hub if keep else write_tables
            self._count(write(self.folder, self._scenes(snapshot, pipeline)), adds, counts, kinds, kept)
        if keep:
            for name in set(LAYOUTS[1:]) - set(work.layouts):
                shutil.rmtree(self.folder / name, ignore_errors=True)
            clear_walks(self.folder, kept)
        terms = licences(unit.partition for unit in work.units)
        libraries = {name: metadata.version(name) for name in _LIBRARIES}
        notes = scene_notes(snapshot, pipeline, work.units)
        record = {
            "schema_version": SCHEMA_VERSION,
            "split": work.target.split,
            "export_snapshot": work.target.snapshot,
            "snapshot": snapshot.snapshot_id,
            "layouts": list(work.layouts),
            "cameras": {name: camera.model_dump(mode="json") for name, camera in work.cameras.items()},
            "config": work.config.model_dump(mode="json"),
            "images_written": keep,
            "kinds": kinds,
            **counts,
            "licences": terms,
            "scene_files": {unit.unit_id: scene_files(unit) for unit in work.units if unit.fault is None},
            "libraries": libraries,
            "encoders": dict(encoders()),
            "decoders": dict(decoders()),
            "notes": notes,
        }
        with atomic_stream(self.folder / "README.md") as stream:
            stream.write(read_me(work.target.split, terms, RECIPE_FILES, images=keep).encode())
        with atomic_stream(self.folder / RECORD) as stream:
            stream.write(orjson.dumps(record, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS) + b"\n")
        if keep:
            with new_folder(self.folder / RECIPE) as part:
                for name in RECIPE_FILES:
                    link(self.folder / name, part / name)
        if compared is not None:
            self._compare(report, compared, libraries)
        return {**counts, "kinds": kinds, "notes": notes, "folder": str(self.folder)}

    def _compare(self, report: Report, compared: Comparison, libraries: dict[str, str]) -> None:
        """Add to the report whether the images are those of the recipe."""
        for unit in self.work.units:
            compared.add_files(unit)
        report.document |= compared.document()
        report.lines += compared.lines(libraries)
        report.exit_code = report.exit_code or compared.exit_code

    def _views(self) -> Iterator[AbstractContextManager[AddScene]]:
        """Yield the writers of the requested layouts. The hub, StreamVLN's layout whose images all others share, is not
        among them: it is written in any case.
        """
        for name in self.work.layouts:
            if name in _VIEWS:
                yield _VIEWS[name](self.folder, self.work.target.split)
            elif name in _OF_ALL_CAMERAS:
                yield _OF_ALL_CAMERAS[name](self.folder, self.work.target.split, self.work.cameras)

    @staticmethod
    def _count(
        scenes: Iterator[SceneWalks],
        views: Sequence[AddScene],
        counts: dict[str, int],
        kinds: dict[str, int],
        kept: set[str],
    ) -> None:
        """Pass each scene to the layouts `views`, and add the scene's numbers to `counts`, `kinds` and `kept`."""
        for scene in scenes:
            for add in views:
                add(scene)
            rows = scene.trajectories()
            poses = scene.tables["poses"]
            counts["trajectories"] += len(rows)
            counts["episodes"] += len({row["episode_id"] for row in rows})
            counts["frames"] += sum(row["n_frames"] for row in rows if row["frames_of"] == row["trajectory"])
            counts["images"] += poses.num_rows
            counts["bytes"] += sum(poses["bytes"].to_pylist())
            # Equal images are hard links to one file.
            stored = poses.group_by("sha256").aggregate([("bytes", "min")])
            counts["stored_bytes"] += sum(stored["bytes_min"].to_pylist())
            counts["left_out"] += scene.tables["left_out"].num_rows
            for row in rows:
                kinds[row["kind"]] = kinds.get(row["kind"], 0) + 1
                kept.add(row["frames_of"])

    def _scenes(self, snapshot: Snapshot, pipeline: Pipeline) -> Iterator[SceneWalks]:
        """Yield the scenes of a snapshot in the order of their ids; one at a time is in memory."""
        for unit in sorted(self.work.units, key=lambda unit: unit.unit_id):
            tables = {}
            for name, schema in TRAJECTORY_TABLES.items():
                table = snapshot.unit_table(unit.unit_id, pipeline, name)
                tables[name] = table if table.num_columns else schema.empty_table()
            if any(table.num_rows for table in tables.values()):
                yield SceneWalks(unit.partition, str(unit.payload["scene_id"]), tables)
