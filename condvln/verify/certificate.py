"""The certificate of an episode: which facts were checked by which rules, and all disagreements between the files and
the scene.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

from condvln.own_tables import own_rows
from schemas.config import (
    AgentConfig,
    Config,
    EpisodeConfig,
    GoalsConfig,
    PlacesConfig,
    SamplingConfig,
    TextConfig,
    Thresholds,
)

__all__ = [
    "FACTS",
    "Certificate",
    "Disagreement",
    "VerifierRules",
]

FACTS: Final = {row["fact"]: row["meaning"] for row in own_rows("condvln.verify", "facts.csv")}
"""Every kind of fact that is checked, with its description, from ``facts.csv``."""


class Disagreement(NamedTuple):
    """A fact on which files and scene disagree, with the claimed and the found value; `place` names the part of the
    episode that the fact is about.
    """

    fact: str
    place: str
    claimed: Any
    found: Any

    def __str__(self) -> str:
        place = f" of {self.place}" if self.place else ""
        return f"{self.fact}{place}: the files say {self.claimed}, found {self.found}"


@dataclass(slots=True)
class Certificate:
    """The result for one episode, for one path over viewpoints, or for one text that has no episode.

    checked : how often each kind of fact was checked
    conditions : what was found about each condition, in the program's order
    unproven : facts that can't be proven of this episode or text, each with the reason
    """

    episode_id: int | str
    source: str
    scene_id: str
    split: str
    checked: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    conditions: list[dict[str, Any]] = field(default_factory=list)
    disagreements: list[Disagreement] = field(default_factory=list)
    unproven: dict[str, str] = field(default_factory=dict)
    kind: Literal["episode", "path", "text"] = "episode"

    @property
    def proven(self) -> bool:
        """Whether every checked fact holds."""
        return not self.disagreements

    def same(self, fact: str, claimed: Any, found: Any, place: str = "") -> bool:
        """Record and return whether two values are equal."""
        return self.holds(fact, claimed == found, claimed, found, place)

    def close(self, fact: str, claimed: float, found: float, tolerance: float, place: str = "") -> bool:
        """Record and return whether two numbers differ by at most `tolerance`; NaN and infinities never agree."""
        return self.holds(fact, abs(claimed - found) <= tolerance, claimed, found, place)

    def holds(self, fact: str, agreed: bool, claimed: Any, found: Any, place: str = "") -> bool:
        """Count one check of a fact. If `agreed` is false, also record the claimed and the found value as a
        disagreement. Return `agreed`.
        """
        assert fact in FACTS, fact
        self.checked[fact] += 1
        if not agreed:
            self.disagreements.append(Disagreement(fact, place, claimed, found))
        return agreed

    def document(self) -> dict[str, Any]:
        """Return the certificate as JSON."""
        return {
            "episode_id": self.episode_id,
            "source": self.source,
            "scene_id": self.scene_id,
            "split": self.split,
            "kind": self.kind,
            "proven": self.proven,
            "checked": dict(sorted(self.checked.items())),
            "conditions": self.conditions,
            "unproven": self.unproven,
            "disagreements": [disagreement._asdict() for disagreement in self.disagreements],
        }


@dataclass(frozen=True, slots=True)
class VerifierRules:
    """The parts of a configuration that decide whether an episode is valid."""

    thresholds: Thresholds = field(default_factory=Thresholds)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    goals: GoalsConfig = field(default_factory=GoalsConfig)
    episodes: EpisodeConfig = field(default_factory=EpisodeConfig)
    text: TextConfig = field(default_factory=TextConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    anchor_size: float = SamplingConfig().anchor_size
    language: str = "en"
    directions: str = "compass"

    @classmethod
    def of(cls, config: Config) -> VerifierRules:
        """Return the rules of a configuration."""
        sections = ("thresholds", "places", "goals", "episodes", "text", "agent")
        return cls(
            **{name: getattr(config, name) for name in sections},
            anchor_size=config.sampling.anchor_size,
            language=config.instructions.language,
            directions=config.instructions.directions,
        )
