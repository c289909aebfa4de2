"""``condvln trajectories``: make training data in the agents' own layouts. Each scene is one task, a stopped run can be
resumed, and tables and layouts are written from the run's published snapshot.
"""

from __future__ import annotations

import shutil
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import orjson
from rich.console import Console

from condvln.formats.image_files import encoders
from condvln.formats.streams import indented, write_file
from condvln.manifest import manifest_lines, manifest_path
from condvln.navigation.follower import ActionSpace
from condvln.sensors.textures import decoders
from condvln.trajectories.cameras import Sweep, hub_cameras
from condvln.trajectories.hub import ANNOTATIONS, AddScene, Hub, Layout, SceneWalks, write_hub, write_tables
from condvln.trajectories.images import IMAGES, clear_parts, clear_walks
from condvln.trajectories.internvla import internvla_n1
from condvln.trajectories.janusvln import janusvln
from condvln.trajectories.layouts import HUBS, link, new_folder, sized, with_hub
from condvln.trajectories.lerobot import lerobot
from condvln.trajectories.navila import navila
from condvln.trajectories.recipe import RECIPE_FILES, RECORD, Recipe, licences, read_me, refuse_unlicensed
from condvln.trajectories.uninavid import uninavid
from factory.commits import Commits
from factory.files import FileHashes
from factory.pipeline import Pipeline, TableSpec
from factory.report import ABORTED
from factory.run import run
from factory.snapshot import Snapshot
from factory.stage import Stage, Unit
from factory.store import LocalStore
from jobs.compose import refuse_export
from jobs.executor import every_node_sees, open_executor
from jobs.generate import run_report
from jobs.progress import LoggedRun, RunProgress
from jobs.report import Report
from jobs.settings import read_section
from jobs.stages.trajectories import NO_IMAGES, NOTES, STAMP, FrameStage, RecipeStage, WalkStage, stamp_path
from jobs.trajectory_units import (
    Comparison,
    WalkedSplit,
    encoder_lines,
    estimate,
    find_split,
    list_units,
    plan_lines,
    recipe_target,
    recipe_units,
    scene_files,
)
from jobs.workspace import alone, git_revision, hasher
from schemas.base import SCHEMA_VERSION
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import CondVLNError, StoreError, UsageError
from schemas.tables import SORT_KEYS, TRAJECTORY_TABLES

__all__ = ["LAYOUTS", "RECORD", "WRITERS", "WRITTEN", "Request", "make_trajectories", "note_lines", "trajectory_config"]

WRITERS: Final[Mapping[str, Layout]] = {
    "navila": navila,
    "uninavid": uninavid,
    "janusvln": janusvln,
    "internvla-n1": internvla_n1,
    "lerobot": lerobot,
}
"""Layouts with a folder of their own."""

LAYOUTS: Final = (*HUBS, *WRITERS)
"""Names of the layouts. The first two are the hub's own files."""

STATE: Final = ".condvln"
"""Store of the run below the folder: what is committed, and who wrote which images."""

RECIPE: Final = "recipe"
"""Folder with links to the files of the recipe, so that they can be passed on without the images."""

WRITTEN: Final = (*RECIPE_FILES, ANNOTATIONS, RECIPE, *WRITERS, f"navila/{ANNOTATIONS}")
"""Files and folders that are written under another name until they are complete, beside the folders of images."""

REF: Final = "trajectories"
COUNTED: Final = ("trajectories", "episodes", "frames", "images", "bytes", "stored_bytes", "left_out")

SHOWN: Final = 10
"""Number of different notes shown on a terminal; ``trajectories.json`` has all of them."""
NAMED: Final = 3
"""Number of scenes that a note names."""

_LIBRARIES: Final = ("isal", "numba", "numpy", "pillow", "pyarrow", "simplejpeg")
"""Libraries whose versions may change images or tables."""


@dataclass(frozen=True)
class Request:
    """What is asked of a run.

    target : a configuration or an export; overrides, scenes : as `find_split` takes them
    licensed : the user has accepted the terms of scenes whose images may not be passed on
    recipe_only : render and hash the images, and do not write them
    recipe : folder of a recipe, whose walks and images are made again; `target` is empty then, and the split, cameras
        and configuration are those of the recipe
    """

    target: str
    out: Path
    split: str = "train"
    layouts: tuple[str, ...] = ("streamvln",)
    camera: str = "streamvln"
    sweep: Sweep | None = None
    config: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    scenes: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    workers: int | None = None
    inline: bool = False
    plan: bool = False
    retry: bool = False
    licensed: bool = False
    recipe_only: bool = False
    recipe: Path | None = None


def trajectory_config(walks: Sequence[str], keys: Sequence[str]) -> TrajectoryConfig:
    """Return the configuration of walks with some keys set.

    walks : kinds of walks; the default if empty
    keys : ``jpeg_quality=80`` and the like

    Raises
    ------
    UsageError : a text is not of the form ``key=value``, an unknown key, or a value that is not allowed
    """
    given = {"walks": list(walks)} if walks else {}
    return read_section(TrajectoryConfig, keys, option="--walk", example="jpeg_quality=80", given=given)


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
    _refuse_strangers(folder)
    _refuse_links(folder, (IMAGES, RECIPE, *WRITERS))
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

    target: WalkedSplit
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
    target = find_split(request.target, request.split, request.scenes, request.overrides)
    lines = manifest_lines(manifest_path(target.export, target.split))
    _refuse_unlicensed(request, (str(line.fields().get("source")) for line in lines))
    cameras = hub_cameras(request.camera, request.layouts, request.sweep)
    config = sized(request.config, request.layouts)
    units = list_units(target, cameras, config, hasher(hashes))
    own = target.config
    texts = target.texts if "oracle" in config.walks else None
    stage = WalkStage(config, texts, own.limits)
    return _Work(target, config, cameras, with_hub(request.layouts, config), units, stage)


def _recipe_work(request: Request, hashes: FileHashes) -> _Work:
    assert request.recipe is not None
    recipe = Recipe(request.recipe.resolve())
    _refuse_unlicensed(request, (family for family, _ in recipe.scenes))
    target = recipe_target(recipe, request.scenes)
    record = recipe.record
    layouts = tuple(name for name in record.layouts if name in LAYOUTS)
    sized(record.config, layouts)
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
        _forget_damaged(store, self.folder, state)
        ray = self.work.target.config.ray
        if self.request.workers is not None:
            ray = ray.model_copy(update={"workers": self.request.workers})
        with (
            RunProgress(self.console) as bar,
            LoggedRun(store, state, bar) as log,
            open_executor(
                ray,
                inline=self.request.inline,
                say=bar.note,
                folders=[*every_node_sees(self.work.target.config), str(self.folder)],
            ) as executor,
        ):
            done = run(
                pipeline,
                self.work.units,
                store,
                REF,
                executor,
                budget=ray.max_failures,
                progress=log,
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
            tables={name: TableSpec(schema, SORT_KEYS[name]) for name, schema in TRAJECTORY_TABLES.items()},
        )

    def _assemble(self, snapshot: Snapshot, pipeline: Pipeline, report: Report) -> dict[str, Any]:
        """Write the tables and layouts from the snapshot and, last, the record of the run; return the counts."""
        counts = dict.fromkeys(COUNTED, 0)
        kinds: Counter[str] = Counter()
        kept: set[str] = set()
        work = self.work
        keep = not self.request.recipe_only
        compared = None if work.recipe is None else Comparison(work.recipe)
        with ExitStack() as stack:
            hub = Hub(self.folder, work.target.split, work.cameras, ActionSpace(work.config.forward, work.config.turn))
            named = [name for name in work.layouts if name in WRITERS] if keep else []
            adds = [stack.enter_context(WRITERS[name](hub)) for name in named]
            if compared is not None:
                adds.append(compared.add)
            annotated = keep and bool(set(HUBS) & set(work.layouts))
            write = write_hub if annotated else write_tables
            self._count(write(self.folder, self._scenes(snapshot, pipeline)), adds, counts, kinds, kept)
        if keep:
            for name in WRITERS.keys() - set(work.layouts):
                shutil.rmtree(self.folder / name, ignore_errors=True)
            if not annotated:
                (self.folder / ANNOTATIONS).unlink(missing_ok=True)
            clear_walks(self.folder, kept)
        terms = licences(unit.partition for unit in work.units)
        libraries = {name: metadata.version(name) for name in _LIBRARIES}
        notes = _scene_notes(snapshot, pipeline, work.units)
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
        read = read_me(work.target.split, terms, RECIPE_FILES, images=keep)
        write_file(self.folder / "README.md", read.encode())
        write_file(self.folder / RECORD, indented(record, orjson.OPT_SORT_KEYS))
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

    @staticmethod
    def _count(
        scenes: Iterator[SceneWalks],
        views: Sequence[AddScene],
        counts: dict[str, int],
        kinds: Counter[str],
        kept: set[str],
    ) -> None:
        """Pass each scene to the layouts `views`, and add the scene's numbers to `counts`, `kinds` and `kept`."""
        for scene in scenes:
            for add in views:
                add(scene)
            rows = scene.trajectories()
            kinds.update(row["kind"] for row in rows)
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
            kept.update(row["frames_of"] for row in rows)

    def _scenes(self, snapshot: Snapshot, pipeline: Pipeline) -> Iterator[SceneWalks]:
        """Yield the scenes of a snapshot in the order of their ids; one at a time is in memory."""
        for unit in sorted(self.work.units, key=lambda unit: unit.unit_id):
            tables = {}
            for name, schema in TRAJECTORY_TABLES.items():
                table = snapshot.unit_table(unit.unit_id, pipeline, name)
                tables[name] = table if table.num_columns else schema.empty_table()
            if any(table.num_rows for table in tables.values()):
                yield SceneWalks(unit.partition, str(unit.payload["scene_id"]), tables)


def _refuse_strangers(folder: Path) -> None:
    """Refuse a folder with files that this command did not write."""
    if folder.exists() and not folder.is_dir():
        raise UsageError("this is a file", where=folder, place="--out", remedy="Name a folder.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / STATE).is_dir() and not (folder / RECORD).is_file():
        raise UsageError(
            "the folder holds files that condvln trajectories did not write",
            where=folder,
            place="--out",
            remedy="Name an empty folder.",
        )


def _refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder of which one of `names` is a link: a run replaces and removes what is in them, and must not do so
    elsewhere.
    """
    for path in (folder / name for name in names):
        if path.is_symlink():
            raise UsageError(
                "this is a link, and what a run replaces or removes would lie outside of its folder",
                where=path,
                place="--out",
                remedy="Name the folder on the other disk by --out, or let the whole folder be a link.",
            )


def _forget_damaged(store: LocalStore, folder: Path, state: Path) -> None:
    """Remove the commits of images that are missing, truncated or overwritten by another commit, so that the images are
    made again.
    """
    commits = Commits(store)
    for stage, key in [*commits.committed()]:
        if stage != "frames":
            continue
        found = commits.find(stage, key)
        if found is None:
            continue
        commit = found.commit
        try:
            stamp = commits.file(commit, STAMP)
            if stamp == NO_IMAGES:
                continue
            sound = stamp_path(state, commit.unit_id).read_bytes() == stamp
            poses = commits.table(stage, key, "poses")
        except (CondVLNError, OSError):
            sound = False
        if not (sound and _complete(folder, poses.select(["image", "bytes"]).to_pylist())):
            commits.discard(stage, key)


def _complete(folder: Path, images: Sequence[Mapping[str, Any]]) -> bool:
    sizes: dict[Path, dict[str, int]] = {}
    for image in images:
        path = folder / image["image"]
        if path.parent not in sizes:
            with suppress(OSError):
                sizes[path.parent] = {entry.name: entry.stat().st_size for entry in path.parent.iterdir()}
        if sizes.get(path.parent, {}).get(path.name) != image["bytes"]:
            return False
    return True


def _scene_notes(snapshot: Snapshot, pipeline: Pipeline, units: Sequence[Unit]) -> dict[str, list[str]]:
    """Return the notes of each scene that has some, by unit id, sorted."""
    found = {}
    for unit_id in sorted(unit.unit_id for unit in units):
        notes = orjson.loads(snapshot.unit_files(unit_id, pipeline).get(NOTES, b"[]"))
        if notes:
            found[unit_id] = [str(note) for note in notes]
    return found


def note_lines(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Return a sentence for each different note, the most frequent first, with the scenes that have it."""
    scenes: defaultdict[str, list[str]] = defaultdict(list)
    for unit_id, texts in notes.items():
        for text in texts:
            scenes[text].append(unit_id)
    ranked = sorted(scenes, key=lambda text: (-len(scenes[text]), text))
    lines = []
    for text in ranked[:SHOWN]:
        named = scenes[text]
        more = f" and {len(named) - NAMED:,} more scenes" if len(named) > NAMED else ""
        lines.append(f"{', '.join(named[:NAMED])}{more}: {text}")
    if len(ranked) > SHOWN:
        lines.append(f"… and {len(ranked) - SHOWN:,} more notes, see notes in trajectories.json")
    return lines
