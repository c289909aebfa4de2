"""``condvln trajectories``: training data in the agents' own layouts, one scene a task, resumable and published."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import orjson
from rich.console import Console

from condvln.compiled import warm_up
from condvln.formats.streams import atomic_stream
from condvln.trajectories.cameras import Sweep, hub_cameras
from condvln.trajectories.hub import SceneWalks, write_hub
from condvln.trajectories.images import clear_parts, folders_of
from condvln.trajectories.internvla import internvla_n1
from condvln.trajectories.layouts import AddScene, Layout, janusvln, navila
from condvln.trajectories.uninavid import uninavid
from factory.commits import Commits
from factory.files import FileHashes
from factory.heartbeat import Busy
from factory.local_store import LocalStore
from factory.pipeline import Pipeline, TableSpec
from factory.receipt import Receipt
from factory.report import ABORTED
from factory.run import run
from factory.snapshot import Snapshot
from factory.unit import Unit
from jobs.assignments import read_section
from jobs.compose import refuse_export
from jobs.generate import CompilationNote, open_executor, run_report
from jobs.progress import LoggedRun, RunProgress
from jobs.report import Report
from jobs.stages.trajectories import STAMP, FrameStage, WalkStage, stamp_path
from jobs.store_lock import alone
from jobs.trajectory_units import Estimate, Target, estimate, find_target, list_units
from jobs.workspace import git_revision, hasher
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import CondVLNError, StoreError, UsageError
from schemas.trajectory_tables import TRAJECTORY_SORT_KEYS, TRAJECTORY_TABLES
from schemas.version import SCHEMA_VERSION

__all__ = ["LAYOUTS", "RECORD", "Request", "make_trajectories", "trajectory_config"]

_VIEWS: Final[Mapping[str, Layout]] = {"navila": navila, "uninavid": uninavid, "janusvln": janusvln}
"""Layouts that need the main camera only."""

LAYOUTS: Final = ("streamvln", *_VIEWS, "internvla-n1")
"""Names of the layouts. The first one is the hub, which is always written."""

RECORD: Final = "trajectories.json"
"""The folder's own record: layouts, cameras, configuration, counts and versions. It is written last."""

STATE: Final = ".condvln"
"""Store of the run below the folder: what is committed, and who wrote which images."""

REF: Final = "trajectories"

_STAGE_OF: Final = {"trajectories": "walks", "left_out": "walks", "poses": "frames"}
_LIBRARIES: Final = ("numpy", "numba", "pillow", "pyarrow")
"""Libraries whose versions may change images or tables."""


@dataclass(frozen=True)
class Request:
    """What is asked of a run.

    target : a configuration or an export; overrides, scenes, roots : as `find_target` takes them
    """

    target: str
    out: Path
    split: str = "train"
    layouts: tuple[str, ...] = ("streamvln",)
    camera: str = "streamvln"
    sweep: Sweep | None = None
    config: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    scenes: tuple[str, ...] = ()
    roots: tuple[Path, ...] = ()
    overrides: tuple[str, ...] = ()
    workers: int | None = None
    inline: bool = False
    plan: bool = False
    retry: bool = False


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
    target = find_target(request.target, request.split, request.scenes, request.roots, request.overrides)
    cameras = hub_cameras(request.camera, request.layouts, request.sweep)
    folder = request.out.resolve()
    _refuse_strangers(folder)
    refuse_export(target.export, folder)
    state = folder / STATE
    hashes = FileHashes(state / ".hashes.sqlite" if state.is_dir() else None)
    rendered = [kind for kind in request.config.walks if kind != "oracle"]
    walks = sum(request.config.recoveries if kind == "recovery" else 1 for kind in rendered) or 1
    units = list_units(target, cameras, float(walks), hasher(hashes))
    hashes.save()
    expected = estimate(units, cameras)
    if request.plan:
        return _planned(expected, folder)
    for line in _plan_lines(expected, folder):
        console.print(line, highlight=False, markup=False)
    with alone(state, REF) as held:
        if not held:
            raise StoreError(
                "another run writes to this folder", where=folder, remedy="Wait until it is done, or name another one."
            )
        return _Run(request, target, cameras, folder, units, expected, console).go()


@dataclass
class _Run:
    request: Request
    target: Target
    cameras: dict[str, CameraConfig]
    folder: Path
    units: list[Unit]
    expected: Estimate
    console: Console

    def go(self) -> Report:
        state = self.folder / STATE
        store = LocalStore(state)
        clear_parts(self.folder)
        pipeline = self._pipeline(state)
        _forget_damaged(store, self.folder, state)
        warm_up(CompilationNote(self.console), only={"paths", "follower", "cameras"})
        ray = self.target.config.ray
        if self.request.workers is not None:
            ray = ray.model_copy(update={"workers": self.request.workers})
        with (
            RunProgress(self.console) as bar,
            LoggedRun(store, state, _Speed(bar, Commits(store), self.console)) as log,
            open_executor(ray, self.request.inline, bar.note) as executor,
        ):
            done = run(
                pipeline,
                self.units,
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
            counts = self._assemble(Snapshot.open(store, REF), pipeline)
            report.document |= counts
            report.lines.append(
                f"{counts['trajectories']:,} walks of {counts['episodes']:,} episodes, {counts['images']:,} images, "
                f"{counts['bytes'] / 1e9:.2f} GB in {self.folder}"
            )
            if counts["left_out"]:
                report.lines.append(f"{counts['left_out']:,} walks left out: see left_out.parquet")
        return report

    def _pipeline(self, state: Path) -> Pipeline:
        config = self.request.config
        texts = self.target.texts if "oracle" in config.walks else None
        stages = (
            WalkStage(config, texts),
            FrameStage(self.folder, state, self.cameras, config, self.target.config.limits),
        )
        return Pipeline(
            name="trajectories",
            stages=stages,
            tables={
                name: TableSpec(schema, TRAJECTORY_SORT_KEYS[name], _STAGE_OF[name])
                for name, schema in TRAJECTORY_TABLES.items()
            },
        )

    def _assemble(self, snapshot: Snapshot, pipeline: Pipeline) -> dict[str, Any]:
        """Write the tables and layouts from the snapshot and, last, the record of the run; return the counts."""
        counts = {"trajectories": 0, "episodes": 0, "frames": 0, "images": 0, "bytes": 0, "left_out": 0}
        kinds: dict[str, int] = {}
        kept: set[str] = set()
        with ExitStack() as stack:
            views = [stack.enter_context(view) for view in self._views()]
            self._count(write_hub(self.folder, self._scenes(snapshot, pipeline)), views, counts, kinds, kept)
        for name in set(LAYOUTS[1:]) - set(self.request.layouts):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name, path in folders_of(self.folder).items():
            if name not in kept:
                shutil.rmtree(path)
        record = {
            "schema_version": SCHEMA_VERSION,
            "split": self.target.split,
            "export_snapshot": self.target.snapshot,
            "snapshot": snapshot.snapshot_id,
            "layouts": list(self.request.layouts),
            "cameras": {name: camera.model_dump(mode="json") for name, camera in self.cameras.items()},
            "config": self.request.config.model_dump(mode="json"),
            "kinds": kinds,
            **counts,
            "libraries": {name: metadata.version(name) for name in _LIBRARIES},
        }
        with atomic_stream(self.folder / RECORD) as stream:
            stream.write(orjson.dumps(record, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS) + b"\n")
        return {**counts, "kinds": kinds, "folder": str(self.folder)}

    def _views(self) -> Iterator[AbstractContextManager[AddScene]]:
        """Yield the writers of the requested layouts. The hub (the layout that is always written) is not among them."""
        for name in self.request.layouts:
            if name in _VIEWS:
                yield _VIEWS[name](self.folder, self.target.split)
            elif name == "internvla-n1":
                yield internvla_n1(self.folder, self.target.split, self.cameras)

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
            counts["left_out"] += scene.tables["left_out"].num_rows
            for row in rows:
                kinds[row["kind"]] = kinds.get(row["kind"], 0) + 1
                kept.add(row["frames_of"])

    def _scenes(self, snapshot: Snapshot, pipeline: Pipeline) -> Iterator[SceneWalks]:
        """Yield the scenes of a snapshot in the order of their ids; one at a time is in memory."""
        for unit in sorted(self.units, key=lambda unit: unit.unit_id):
            tables = {}
            for name, schema in TRAJECTORY_TABLES.items():
                table = snapshot.unit_table(unit.unit_id, pipeline, name)
                tables[name] = table if table.num_columns else schema.empty_table()
            if tables["poses"].num_rows:
                yield SceneWalks(unit.partition, str(unit.payload["scene_id"]), tables)


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


class _Speed:
    """Progress that also shows images a second, the time left, and the disk used so far."""

    def __init__(self, inner: RunProgress, commits: Commits, console: Console) -> None:
        self._inner, self._commits, self._console = inner, commits, console
        self._began = time.monotonic()
        self._images, self._bytes = 0.0, 0.0
        self._shown = 0.0

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        self._inner.phase(name, total, seconds, workers)

    def unit(self, receipt: Receipt) -> None:
        for stage in receipt.stages:
            if stage.stage == "frames" and stage.made:
                found = self._commits.find(stage.stage, stage.key.hex(), discard=False)
                if found is not None:
                    self._images += found.commit.measures.get("images", 0.0)
                    self._bytes += found.commit.measures.get("image_bytes", 0.0)
        self._inner.unit(receipt)
        passed = time.monotonic() - self._began
        if self._images and passed - self._shown > 10:
            self._shown = passed
            self._inner.note(
                f"{self._images:,.0f} images, {self._images / passed:.0f} a second, {self._bytes / 1e9:.2f} GB so far"
            )

    def step(self) -> None:
        self._inner.step()

    def note(self, message: str) -> None:
        self._inner.note(message)

    def busy(self, unit: Busy, message: str) -> None:
        self._inner.busy(unit, message)


def _plan_lines(expected: Estimate, folder: Path) -> list[str]:
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(parent).free / 1e9
    lines = [
        f"{expected.episodes:,} episodes of {expected.scenes:,} scenes: about {expected.frames:,} frames, "
        f"{expected.images:,} images, {expected.gigabytes:.2f} GB, {expected.hours:.2f} CPU hours; "
        f"{free:.1f} GB are free"
    ]
    if expected.gigabytes > free:
        lines.append(f"The disk of {folder} is too small for this.")
    return lines


def _planned(expected: Estimate, folder: Path) -> Report:
    return Report({"plan": asdict(expected)}, _plan_lines(expected, folder))


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
