"""The one configuration file, in YAML.

Every number that decides something has its unit in its name or its description. Unknown keys, wrong types and missing
folders fail at once. Relative paths count from the folder of the configuration file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from schemas.base import Document, Finite
from schemas.episode import Composition
from schemas.program import CATEGORIES, Category

__all__ = [
    "AgentConfig",
    "Config",
    "EpisodeConfig",
    "Family",
    "InstructionCell",
    "InstructionsConfig",
    "KeepConfig",
    "LimitsConfig",
    "RayConfig",
    "SourceConfig",
    "SplitsConfig",
    "Thresholds",
]

Family = Literal["replicacad", "procthor", "ithor", "robothor", "mp3d", "gibson"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Wanted = Annotated[int, Field(ge=0, le=10_000)]
"""Episodes wanted of one scene: no scene has room for more, and candidates of all of them are held in memory."""


class Section(Document):
    """A part of the configuration. YAML's yes and no are not taken for 1 and 0."""

    @field_validator("*", mode="before")
    @classmethod
    def _yes_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError("true and false are not allowed here")
        return value


class SourceConfig(Section):
    """One dataset on disk."""

    family: Family
    root: Path = Field(description="folder of the dataset")
    scenes: tuple[str, ...] = Field(("*",), min_length=1, description="scene ids or patterns with * and ?")
    exclude: tuple[str, ...] = Field((), description="scene ids or patterns left out")
    regions: Path | None = Field(None, description="side file or folder of user-drawn room zones")
    houses: Path | None = Field(
        None, description="procthor only: folder of the house JSON, where root is Habitat's scene dataset of them"
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


class AgentConfig(Section):
    """The agent the navmesh must fit; Habitat's and VLN-CE's defaults."""

    radius: Positive = Field(0.1, description="metres")
    height: Positive = Field(1.5, description="metres")
    max_climb: Positive = Field(0.2, description="metres")
    max_slope: Positive = Field(45.0, le=90, description="degrees")


class Thresholds(Section):
    """Where relations begin and end: emitted, usable as true in text, usable as false in text. Metres and degrees."""

    near: Positive = 1.0
    near_true: Positive = 0.85
    near_false: Positive = 1.15
    far: Positive = 3.0
    far_true: Positive = 3.45
    far_false: Positive = 2.55
    height: Positive = 0.30
    height_true: Positive = 0.45
    height_false: Positive = 0.15
    over_horizontal: Positive = Field(0.50, description="horizontal distance up to which higher is also above")
    over_horizontal_true: Positive = 0.42
    over_horizontal_false: Positive = 0.65
    over_footprint_true: Share = Field(0.2, description="least footprint overlap for above and below in text")
    sector_true: Positive = Field(15.0, description="degrees from the sector's centre")
    sector_false: Positive = 30.0
    sector_horizontal_true: Positive = Field(0.5, description="least horizontal distance for compass words in text")
    level: Positive = Field(22.5, lt=90, description="elevation below which a pair is level, degrees")
    degenerate_horizontal: Positive = Field(0.1, description="horizontal distance below which direction means little")
    surface_within: Positive = Field(1.15, description="AABB distance up to which the surface distance is asked")

    @model_validator(mode="after")
    def _margins_are_on_the_right_side(self) -> Thresholds:
        for low, middle, high, name in (
            (self.near_true, self.near, self.near_false, "near"),
            (self.far_false, self.far, self.far_true, "far"),
            (self.height_false, self.height, self.height_true, "height"),
            (self.over_horizontal_true, self.over_horizontal, self.over_horizontal_false, "over_horizontal"),
            (self.sector_true, 22.5, self.sector_false, "sector"),
        ):
            if not low < middle < high:
                raise ValueError(
                    f"{name}: {middle:g} must lie between its thresholds in text, got {low:g} and {high:g}"
                )
        if self.surface_within < self.near_false:
            raise ValueError(
                f"surface_within: {self.surface_within:g} must be at least near_false, {self.near_false:g}"
            )
        return self


class InstructionCell(Section):
    """A cell of the axes, and how many episodes of it are wanted a scene; what is not given may be anything."""

    category: Category
    composition: Composition | None = None
    observability: Literal["O0f", "O0", "O1", "O2"] | None = Field(None, description="O0f: O0 within the first view")
    moves: int | None = Field(None, ge=1, le=3, description="moves of every leaf")
    route: tuple[Finite, Finite] | None = Field(
        None, description="[least, most] metres past its stops to every leaf, the gold one's included"
    )
    words: tuple[int, int] | None = Field(None, description="[least, most] words of the text")
    count: int = Field(ge=1, le=10_000)

    @field_validator("route", "words", mode="before")
    @classmethod
    def _yes_is_no_bound(cls, value: Any) -> Any:
        if isinstance(value, list | tuple) and any(isinstance(bound, bool) for bound in value):
            raise ValueError("true and false are not allowed as bounds; write [least, most]")
        return value

    @model_validator(mode="after")
    def _bounds_are_ranges(self) -> InstructionCell:
        if self.route is not None and not 0 <= self.route[0] < self.route[1]:
            least, most = self.route
            raise ValueError(
                f"route: the first bound must be at least 0 m and below the second, got [{least:g}, {most:g}]"
            )
        if self.words is not None and not 1 <= self.words[0] <= self.words[1]:
            raise ValueError(
                f"words: the first bound must be at least 1 and at most the second, got {list(self.words)}"
            )
        return self


class InstructionsConfig(Section):
    """What is sampled of each scene."""

    per_category: dict[Category, Wanted] = Field(
        default_factory=lambda: dict.fromkeys(CATEGORIES, 20), description="episodes wanted a scene"
    )
    cells: tuple[InstructionCell, ...] = Field(
        (), description="episodes wanted of single cells; takes the place of per_category for their categories"
    )
    counterfactual_groups: int = Field(
        2,
        ge=0,
        le=1000,
        description="groups of four a scene, besides: one start, a condition's truth and two leaves exchanged",
    )
    candidates_per_episode: int = Field(8, ge=1, le=1000, description="candidates drawn for each episode wanted")
    moves: tuple[Share, Share, Share] = Field((0.4, 0.4, 0.2), description="shares of leaves with 1, 2, 3 moves")
    label_cap: Share = Field(0.15, description="no label is the target of more than this share of a scene's leaves")
    presence_false_share: Share = Field(
        0.2, description="most label-only conditions among the false ones where a scene is one room"
    )
    presence_share: Share = Field(0.4, description="share of label-only conditions in scenes of several rooms")
    plausible_share: Share = Field(0.05, description="a label is plausible in a room type seen in this share of rooms")
    preamble: bool = Field(True, description="open texts that use compass words with the start heading")

    @model_validator(mode="after")
    def _shares_sum_to_one(self) -> InstructionsConfig:
        if abs(sum(self.moves) - 1.0) > 1e-9:
            raise ValueError(f"moves: the three shares must sum to 1, got {sum(self.moves):g}")
        return self

    @model_validator(mode="after")
    def _cells_differ(self) -> InstructionsConfig:
        axes = [tuple(cell.model_dump(exclude={"count"}).values()) for cell in self.cells]
        for name in axes:
            if axes.count(name) > 1:
                raise ValueError(
                    f"cells: {' '.join(str(part) for part in name if part)} is there twice; add the counts up"
                )
        return self


class EpisodeConfig(Section):
    """Rules of starts, goals and paths. Metres."""

    success_distance_single_room: Positive = 0.5
    success_distance: Positive = 1.0
    island_radius: Positive = Field(1.5, description="least radius of the island an episode stands on")
    distance_single_room: tuple[Finite, Finite] = (1.0, 10.0)
    distance: tuple[Finite, Finite] = (2.0, 30.0)
    leaf_gap: Positive = Field(0.5, description="leaves lie at least 2 success distances plus this apart")
    goal_reach: Positive = Field(0.5, description="goal points lie at most this far from the object's box")
    goal_points: int = Field(8, ge=1, le=1000, description="most goal points of an object")
    goal_reach_at_most: Positive = Field(1.0, description="where nothing nearer can be stood on")
    starts: int = Field(96, ge=1, le=100_000, description="starts drawn a scene, shared by its programs")
    starts_per_program: int = Field(24, ge=1, description="starts tried before a program is given up")
    path_spacing: Positive = Field(0.25, ge=0.001, description="spacing of the dense reference path")
    max_steps: int = Field(500, ge=1, description="step budget's ceiling (VLN-CE's)")
    steps_per_word: int = Field(10, ge=1)
    sight_range: Positive = Field(5.0, description="how far an agent sees; decides the observability axis")
    eye_height: Positive = Field(1.25, description="height of the camera above the agent's feet (habitat-lab's)")
    floor_seen: Share = Field(0.8, description="share of a room's floor that must be seen to know what is not there")
    object_seen: Share = Field(0.05, description="share of an object's surface that must be seen to know it is there")

    @model_validator(mode="after")
    def _distances_are_ranges(self) -> EpisodeConfig:
        for name in ("distance_single_room", "distance"):
            least, most = getattr(self, name)
            if not 0 <= least < most:
                raise ValueError(
                    f"{name}: the first bound must be at least 0 m and below the second, got [{least:g}, {most:g}]"
                )
        return self


class SplitsConfig(Section):
    """How the pool becomes splits; families with official lists keep to them."""

    seed: int = 0
    per_cell: int | None = Field(
        None, ge=1, description="episodes wanted per split × category × gold leaf; none = all that balance"
    )
    scenes: dict[Literal["train", "val_unseen", "test"], tuple[str, ...]] = Field(
        default_factory=dict, description="patterns <family>/<scene> with * and ?, before official lists and hashes"
    )
    sharded: bool = Field(
        False, description="one file a scene, <split>/content/<scene>.json.gz, as Habitat's own datasets have them"
    )
    val_seen_share: Share = Field(0.1, description="share of the train scenes' episodes set aside as val_seen")
    fractions: tuple[Share, Share, Share] = Field((0.8, 0.1, 0.1), description="train, val_unseen, test by id hash")
    max_tokens: int | None = Field(
        200,
        ge=0,
        description="texts of more tokens are left out: VLN-CE's instruction_tokens hold no more, and who reads those "
        "would miss a branch; 0 or none = no limit",
    )
    bias: Literal["off", "warn", "fail"] = Field(
        "warn", description="what an export does when a guess that sees nothing beats chance; fail = exit code 3"
    )

    @model_validator(mode="after")
    def _fractions_sum_to_one(self) -> SplitsConfig:
        if abs(sum(self.fractions) - 1.0) > 1e-9:
            raise ValueError(f"fractions: the three shares must sum to 1, got {sum(self.fractions):g}")
        return self


class LimitsConfig(Section):
    """The largest scene that is worked on. A larger one is quarantined, alone, before the memory for it is taken.

    Relations grow with the square of the objects in a room: about 2.6 rows and 600 bytes an ordered pair.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    objects_per_room: int = Field(1000, ge=2, description="most objects in one room")
    pairs_per_scene: int = Field(
        1_000_000,
        ge=4,
        description="most ordered pairs of objects that share a room: the sum of squares over the rooms",
    )
    objects_per_scene: int = Field(20_000, ge=2, description="most objects in a scene")
    rooms_per_scene: int = Field(2000, ge=1, description="most rooms in a scene")
    corners_per_room: int = Field(20_000, ge=3, description="most corners of a room's outline")


class RayConfig(Section):
    """How a run is spread out."""

    workers: int | None = Field(None, ge=1, description="none = every core")
    address: str | None = Field(None, description="ray:// or host:port of a cluster; none = this machine")
    max_failures: Share = Field(0.5, description="share of failed scenes over which the run is stopped (exit 4)")
    deadline_seconds: Positive = Field(1800.0, description="wall time one scene may take")


class KeepConfig(Section):
    """What the sweep after a rebuild leaves in the store: nothing that a ref names ever goes."""

    sweep: bool = Field(True, description="whether a rebuild that published removes what no ref needs")
    snapshots: int = Field(3, ge=1, description="snapshots kept for each ref, the published one included")
    grace_hours: float = Field(24.0, ge=0, allow_inf_nan=False, description="nothing younger is removed, needed or not")


class Config(Section):
    """One run: sources in, tables and splits out."""

    name: Annotated[
        str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100, description="name of the published ref")
    ]
    seed: int = 0
    store: Path | str = Field(
        description="units, snapshots and refs: a folder, or s3://bucket/prefix[?endpoint=…&region=…]"
    )
    export: Path | None = Field(None, description="folder of the VLN-CE splits")
    sources: tuple[SourceConfig, ...] = Field(min_length=1)
    agent: AgentConfig = Field(default_factory=AgentConfig)
    thresholds: Thresholds = Field(default_factory=Thresholds)
    instructions: InstructionsConfig = Field(default_factory=InstructionsConfig)
    episodes: EpisodeConfig = Field(default_factory=EpisodeConfig)
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
