"""The configured rules that episodes are checked against."""

from __future__ import annotations

from dataclasses import dataclass, field

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

__all__ = ["VerifierRules"]


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
        return cls(
            config.thresholds,
            config.places,
            config.goals,
            config.episodes,
            config.text,
            config.agent,
            config.sampling.anchor_size,
            config.instructions.language,
            config.instructions.directions,
        )
