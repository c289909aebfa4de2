"""The configuration file: a run, its sources, splits, limits, Ray and what the store keeps.

Every number that decides something has its unit in its name or its description. Unknown keys, wrong types and missing
folders fail at once. Relative paths count from the folder of the configuration file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, JsonValue, model_validator

from schemas.base import Hours, Seconds, Section, Share
from schemas.config.constants import MOST_OBJECTS_PER_ROOM
from schemas.config.episodes import AgentConfig, EpisodeConfig, GoalsConfig, PlacesConfig
from schemas.config.instructions import PAPER, InstructionsConfig, SamplingConfig, TextConfig
from schemas.config.relations import Thresholds

__all__ = [
    "Config",
    "Family",
    "KeepConfig",
    "LimitsConfig",
    "RayConfig",
    "SourceConfig",
    "SplitsConfig",
]

Family = Literal["replicacad", "procthor", "ithor", "robothor", "mp3d", "gibson", "hssd", "hm3d", "boxes"]


class SourceConfig(Section):
    """One dataset on disk."""

    family: Family
    """dataset family"""
    root: Path
    """folder of the dataset"""
    scenes: tuple[str, ...] = Field(("*",), min_length=1)
    """scene ids, or patterns with * and ?, that are included"""
    exclude: tuple[str, ...] = ()
    """scene ids, or patterns with * and ?, that are left out"""
    navmesh: str | None = Field(None, min_length=1)
    """folder below root in which navmeshes are looked for first"""
    regions: Path | None = None
    """file or folder with outlines of rooms that the user has drawn"""
    absence: Literal["complete", "never"] = "complete"
    """complete: conditions are asked only in rooms that are annotated completely, where text may say that things are
    absent; never: conditions are asked in all rooms, but only about relations of things that are there, so that no text
    says that something is absent (for annotations by detectors, such as Gibson's automated graphs)"""
    houses: Path | None = None
    """procthor only: folder of the houses' JSON files, needed if root is Habitat's scene dataset of these houses"""
    connectivity: Path | None = None
    """folder of <scan>_connectivity.json for discrete R2R; by default connectivity/ of the dataset"""

    @model_validator(mode="after")
    def _keys_of_one_family(self) -> SourceConfig:
        for key, family in (("houses", "procthor"), ("connectivity", "mp3d")):
            if getattr(self, key) is not None and self.family != family:
                raise ValueError(f"{key} is a key of {family} sources only, and this source is {self.family}")
        return self


class SplitsConfig(Section):
    """How episodes are distributed over splits. Families with official lists of scenes keep to them."""

    seed: int = 0
    """seed of the choice of episodes where there are more than wanted"""
    per_cell: int | None = Field(None, ge=1)
    """number of episodes wanted for each split × category × gold leaf; none = as many as keep the gold leaves
    balanced"""
    statements: Literal["any", "even"] = "any"
    """even = leave out episodes until each statement is asked as often where it is true as where it is false, which
    datasets of thousands of scenes need to pass the bias gate; any = leave out none for that"""
    scenes: dict[Literal["train", "val_unseen", "test"], tuple[str, ...]] = Field(default_factory=dict)
    """patterns <family>/<scene> with * and ? that assign scenes to splits, before official lists and hashes do"""
    sharded: bool = False
    """write one file per scene, <split>/content/<scene>.json.gz, as Habitat's own datasets do"""
    val_seen_share: Share = 0.1
    """share of the train scenes' episodes set aside as val_seen"""
    fractions: tuple[Share, Share, Share] = (0.8, 0.1, 0.1)
    """shares of train, val_unseen and test where scenes are assigned by the hash of their id"""
    max_tokens: int | None = Field(200, ge=0)
    """maximum number of tokens of a text; longer texts are left out, since VLN-CE's instruction_tokens would cut them
    off and hide a branch from the agent; 0 or none = no limit"""
    bias: Literal["off", "warn", "fail"] = "warn"
    """what an export does when a guesser that sees no scene beats chance; fail = exit code 3"""

    @model_validator(mode="after")
    def _fractions_sum_to_one(self) -> SplitsConfig:
        if abs(sum(self.fractions) - 1.0) > 1e-9:
            raise ValueError(f"fractions: the three shares must sum to 1, got {sum(self.fractions):g}")
        return self


class LimitsConfig(Section):
    """Size limits of a scene. A larger scene is quarantined before memory is allocated for it, and the run goes on with
    the other scenes.

    Relations grow with the square of the objects in a room: about 2.6 rows and 600 bytes an ordered pair.
    """

    objects_per_room: int = Field(1000, ge=2, le=MOST_OBJECTS_PER_ROOM)
    """maximum number of objects in one room"""
    pairs_per_scene: int = Field(1_000_000, ge=4)
    """maximum number of ordered pairs of objects that share a room: the sum over the rooms of the squared number of
    objects"""
    objects_per_scene: int = Field(20_000, ge=2)
    """maximum number of objects in a scene"""
    rooms_per_scene: int = Field(2000, ge=1)
    """maximum number of rooms in a scene"""
    corners_per_room: int = Field(20_000, ge=3)
    """maximum number of corners of a room's outline"""


class RayConfig(Section):
    """Where a run works: in this process, in Ray tasks on this machine, or on a Ray cluster."""

    workers: int | None = Field(None, ge=1)
    """number of Ray workers, however small the work is (1: the work is done in this process); with the address of a
    cluster, the maximum number of tasks in flight; none = every core or the whole cluster, and work of a few seconds is
    done in this process"""
    address: str | None = None
    """of a Ray cluster: host:port, ray://host:port, or auto (the Ray that runs on this machine); none = the environment
    variable RAY_ADDRESS, and without it a Ray that the run starts on this machine; local = that, whatever RAY_ADDRESS
    says"""
    runtime_env: dict[str, JsonValue] = Field(default_factory=dict)
    """what Ray brings to the nodes before the tasks start, as in ray.init: working_dir, py_modules (folders or wheels),
    pip, env_vars; paths are absolute"""
    max_failures: Share = 0.5
    """maximum share of scenes that may fail; with more, the run is stopped (exit code 4)"""
    deadline_seconds: Seconds = 1800.0
    """maximum wall time of one scene; while a scene runs compiled code, it can be stopped only in a worker process"""
    memory_gib: float | None = Field(None, ge=0.5, allow_inf_nan=False)
    """maximum memory of a process while it works on a scene, GiB; a scene that needs more is quarantined; none = 80 %
    of the machine's memory, divided by the number of workers"""


class KeepConfig(Section):
    """What the sweep after a rebuild keeps in the store. Nothing that a ref names is ever removed."""

    sweep: bool = True
    """whether a rebuild, after it has published a snapshot, removes from the store what no ref needs"""
    snapshots: int = Field(3, ge=1)
    """number of snapshots kept for each ref, the published one included"""
    grace_hours: Hours = 24.0
    """files younger than this are never removed"""


class Config(Section):
    """One run: sources in, tables and splits out."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)
    """name (ref) under which the snapshot is published"""
    seed: int = 0
    """seed of all random choices"""
    store: Path | str
    """place of units, snapshots and refs: a folder, or s3://bucket/prefix[?endpoint=…&region=…]"""
    export: Path | None = None
    """folder of the export: VLN-CE splits and manifests"""
    sources: tuple[SourceConfig, ...] = Field(min_length=1)
    """the datasets"""
    agent: AgentConfig = Field(default_factory=AgentConfig)
    thresholds: Thresholds = Field(default_factory=Thresholds)
    places: PlacesConfig = Field(default_factory=PlacesConfig)
    instructions: InstructionsConfig = Field(default_factory=InstructionsConfig)
    sampling: SamplingConfig = Field(default_factory=SamplingConfig)
    goals: GoalsConfig = Field(default_factory=GoalsConfig)
    episodes: EpisodeConfig = Field(default_factory=EpisodeConfig)
    text: TextConfig = Field(default_factory=TextConfig)
    splits: SplitsConfig = Field(default_factory=SplitsConfig)
    limits: LimitsConfig = Field(default_factory=LimitsConfig)
    ray: RayConfig = Field(default_factory=RayConfig)
    keep: KeepConfig = Field(default_factory=KeepConfig)

    @model_validator(mode="before")
    @classmethod
    def _of_a_style(cls, data: Any) -> Any:
        """Give the style's values to the keys that are not given, in a document or in sections made in Python."""
        if not isinstance(data, dict):
            return data
        sections: dict[str, Any] = {}
        for name in PAPER:
            one = data.get(name) or {}
            sections[name] = one.model_dump(include=one.model_fields_set) if isinstance(one, Section) else one
        documents = all(isinstance(one, dict) for one in sections.values())
        if not documents or sections["instructions"].get("style") != "paper":
            return data
        return data | {name: {**PAPER[name], **one} for name, one in sections.items()}

    @model_validator(mode="after")
    def _routes_are_long_enough(self) -> Config:
        least = min(self.episodes.distance_single_room[0], self.episodes.distance[0])
        for k, cell in enumerate(self.instructions.cells):
            # A route is never shorter than the way from its start to its goal.
            if cell.route is not None and cell.route[1] < least:
                raise ValueError(
                    f"instructions.cells.{k}.route: no route is shorter than {cell.route[1]:g} m; every goal is at "
                    f"least {least:g} m from the start (episodes.distance, episodes.distance_single_room)"
                )
        return self
