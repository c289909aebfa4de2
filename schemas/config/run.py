"""The configuration file: a run, its sources, splits, limits, Ray and what the store keeps.

Every number that decides something has its unit in its name or its description. Unknown keys, wrong types and missing
folders fail at once. Relative paths count from the folder of the configuration file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from schemas.config.constants import MOST_OBJECTS_PER_ROOM
from schemas.config.episodes import AgentConfig, EpisodeConfig, GoalsConfig, PlacesConfig
from schemas.config.instructions import InstructionsConfig, SamplingConfig, TextConfig
from schemas.config.relations import Thresholds
from schemas.config.section import Hours, Seconds, Section, Share

__all__ = [
    "MOVED",
    "REMOVED",
    "Config",
    "Family",
    "KeepConfig",
    "LimitsConfig",
    "RayConfig",
    "SourceConfig",
    "SplitsConfig",
]

Family = Literal["replicacad", "procthor", "ithor", "robothor", "mp3d", "gibson", "hssd", "hm3d"]


MOVED: Final = {
    "episodes.success_distance_single_room": "places.success_distance_single_room",
    "episodes.success_distance": "places.success_distance",
    "episodes.leaf_gap": "places.leaf_gap",
    "episodes.island_radius": "places.island_radius",
    "episodes.sight_range": "places.sight_range",
    "episodes.eye_height": "places.eye_height",
    "episodes.goal_reach": "goals.reach",
    "episodes.goal_reach_at_most": "goals.reach_at_most",
    "episodes.goal_points": "goals.points",
    "episodes.steps_per_word": "text.steps_per_word",
    "instructions.preamble": "text.preamble",
    "instructions.candidates_per_episode": "sampling.candidates_per_episode",
    "instructions.moves": "sampling.moves",
    "instructions.presence_false_share": "sampling.presence_false_share",
    "instructions.presence_share": "sampling.presence_share",
    "instructions.plausible_share": "sampling.plausible_share",
}
"""Keys of earlier releases, with their present names."""

REMOVED: Final = {
    "episodes.path_spacing": "the locations of the ground truth are those that the follower walked through",
    "thresholds.top_false": "“higher” is false where the other thing is higher by thresholds.other_way",
}
"""Keys of earlier releases that were removed, with the reason."""


class SourceConfig(Section):
    """One dataset on disk."""

    family: Family = Field(description="dataset family")
    root: Path = Field(description="folder of the dataset")
    scenes: tuple[str, ...] = Field(
        ("*",), min_length=1, description="scene ids, or patterns with * and ?, that are included"
    )
    exclude: tuple[str, ...] = Field((), description="scene ids, or patterns with * and ?, that are left out")
    navmesh: str | None = Field(
        None, min_length=1, description="folder below root in which navmeshes are looked for first"
    )
    regions: Path | None = Field(None, description="file or folder with outlines of rooms that the user has drawn")
    absence: Literal["complete", "never"] = Field(
        "complete",
        description="complete: conditions are asked only in rooms that are annotated completely, where "
        "text may say that things are absent; never: conditions are asked in all rooms, but "
        "only about relations of things that are there, so that no text says that "
        "something is absent (for annotations by detectors, such as Gibson's automated graphs)",
    )
    houses: Path | None = Field(
        None,
        description="procthor only: folder of the houses' JSON files, needed if root is Habitat's scene dataset of "
        "these houses",
    )
    connectivity: Path | None = Field(
        None, description="folder of <scan>_connectivity.json for discrete R2R; by default connectivity/ of the dataset"
    )

    @model_validator(mode="after")
    def _keys_of_one_family(self) -> SourceConfig:
        for key, family in (("houses", "procthor"), ("connectivity", "mp3d")):
            if getattr(self, key) is not None and self.family != family:
                raise ValueError(f"{key} is a key of {family} sources only, and this source is {self.family}")
        return self


class SplitsConfig(Section):
    """How episodes are distributed over splits. Families with official lists of scenes keep to them."""

    seed: int = Field(0, description="seed of the choice of episodes where there are more than wanted")
    per_cell: int | None = Field(
        None,
        ge=1,
        description="number of episodes wanted for each split × category × gold leaf; none = as many as keep "
        "the gold leaves balanced",
    )
    statements: Literal["any", "even"] = Field(
        "any",
        description="even = leave out episodes until each statement is asked as often where it is true as where it is "
        "false, which datasets of thousands of scenes need to pass the bias gate; any = leave out none for that",
    )
    scenes: dict[Literal["train", "val_unseen", "test"], tuple[str, ...]] = Field(
        default_factory=dict,
        description="patterns <family>/<scene> with * and ? that assign scenes to splits, before official "
        "lists and hashes do",
    )
    sharded: bool = Field(
        False, description="write one file per scene, <split>/content/<scene>.json.gz, as Habitat's own datasets do"
    )
    val_seen_share: Share = Field(0.1, description="share of the train scenes' episodes set aside as val_seen")
    fractions: tuple[Share, Share, Share] = Field(
        (0.8, 0.1, 0.1),
        description="shares of train, val_unseen and test where scenes are assigned by the hash of their id",
    )
    max_tokens: int | None = Field(
        200,
        ge=0,
        description="maximum number of tokens of a text; longer texts are left out, since VLN-CE's "
        "instruction_tokens would cut them off and hide a branch from the agent; 0 or none = no limit",
    )
    bias: Literal["off", "warn", "fail"] = Field(
        "warn", description="what an export does when a guesser that sees no scene beats chance; fail = exit code 3"
    )

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

    objects_per_room: int = Field(
        1000, ge=2, le=MOST_OBJECTS_PER_ROOM, description="maximum number of objects in one room"
    )
    pairs_per_scene: int = Field(
        1_000_000,
        ge=4,
        description="maximum number of ordered pairs of objects that share a room: the sum over the rooms of "
        "the squared number of objects",
    )
    objects_per_scene: int = Field(20_000, ge=2, description="maximum number of objects in a scene")
    rooms_per_scene: int = Field(2000, ge=1, description="maximum number of rooms in a scene")
    corners_per_room: int = Field(20_000, ge=3, description="maximum number of corners of a room's outline")


class RayConfig(Section):
    """Where a run works: in processes of this machine, or on Ray."""

    workers: int | None = Field(
        None,
        ge=1,
        description="number of worker processes, however small the work is (1: one besides this one); with the "
        "address of a cluster, the maximum number of tasks in flight; none = every core or the whole cluster, and "
        "small work is done in this process",
    )
    address: str | None = Field(
        None,
        description="of a Ray cluster: ray:// or host:port, or auto; local = a Ray started on this machine; none = "
        "processes of this machine, without Ray",
    )
    max_failures: Share = Field(
        0.5, description="maximum share of scenes that may fail; with more, the run is stopped (exit code 4)"
    )
    deadline_seconds: Seconds = Field(
        1800.0,
        description="maximum wall time of one scene; while a scene runs compiled code, it can be "
        "stopped only in a worker process",
    )
    memory_gib: float | None = Field(
        None,
        ge=0.5,
        allow_inf_nan=False,
        description="maximum memory of a process while it works on a scene, GiB; a scene that needs more is "
        "quarantined; none = 80 % of the machine's memory, divided by the number of workers",
    )


class KeepConfig(Section):
    """What the sweep after a rebuild keeps in the store. Nothing that a ref names is ever removed."""

    sweep: bool = Field(
        True,
        description="whether a rebuild, after it has published a snapshot, removes from the store what no ref needs",
    )
    snapshots: int = Field(3, ge=1, description="number of snapshots kept for each ref, the published one included")
    grace_hours: Hours = Field(24.0, description="files younger than this are never removed")


class Config(Section):
    """One run: sources in, tables and splits out."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
            max_length=100,
            description="name (ref) under which the snapshot is published",
        ),
    ]
    seed: int = Field(0, description="seed of all random choices")
    store: Path | str = Field(
        description="place of units, snapshots and refs: a folder, or s3://bucket/prefix[?endpoint=…&region=…]"
    )
    export: Path | None = Field(None, description="folder of the export: VLN-CE splits and manifests")
    sources: tuple[SourceConfig, ...] = Field(min_length=1, description="the datasets")
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
