"""The kinds of findings of the linter, each with a code, a severity and a remedy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["CODES", "Finding", "LintReport", "Rule", "Severity"]

Severity = Literal["error", "warning"]
"""An error crashes a known loader or makes a score wrong; a warning may be intended."""


@dataclass(frozen=True)
class Rule:
    """One kind of finding."""

    severity: Severity
    remedy: str


CODES: Final[dict[str, Rule]] = {
    # the file
    "unreadable": Rule("error", "write the file again; it is cut, damaged or not JSON"),
    "not-a-number": Rule("error", "JSON has no NaN or Infinity: drop the episode or give its true value"),
    "unknown-shape": Rule("error", "a VLN-CE file is {episodes, instruction_vocab}, ground truth {id: …}, R2R a list"),
    "unknown-top-key": Rule("warning", "loaders ignore it; remove it"),
    "no-episodes": Rule("warning", "Habitat answers an empty dataset with 'No scenes to load'"),
    # the vocabulary
    "missing-vocabulary": Rule("error", "loaders read instruction_vocab.word_list and fail without it"),
    "vocabulary-inconsistent": Rule("error", "word_list, stoi, itos, word2idx_dict and num_vocab must agree"),
    "vocabulary-differs": Rule("error", "all splits share one vocabulary: embeddings are trained on its numbers"),
    # keys
    "unknown-key": Rule("error", "strict loaders raise TypeError: move it under info"),
    "missing-key": Rule("error", "strict loaders need it"),
    "wrong-type": Rule("error", "give a value of the type that loaders expect"),
    "goals-withheld": Rule("warning", "a split without published goals can't be scored; allowed for a test split"),
    # ids and scenes
    "duplicate-id": Rule("error", "ids are compared as text and must differ: later results overwrite earlier ones"),
    "id-not-integer": Rule("warning", "collectors of StreamVLN and DAgger call int() on it: export again"),
    "scene-path": Rule("error", "scene_id is a path below scene_datasets such as mp3d/<scan>/<scan>.glb"),
    "scene-prefix": Rule("warning", "loaders prefix SCENES_DIR themselves: leave data/scene_datasets/ out"),
    # geometry
    "not-finite": Rule("error", "drop the episode or give its true value"),
    "rotation-norm": Rule("error", "a rotation is a unit quaternion"),
    "rotation-order": Rule("error", "episodes hold [x, y, z, w]; this reads like [w, x, y, z]"),
    "rotation-tilted": Rule("warning", "agents stand upright: a start rotation is about +y only"),
    "reference-start": Rule("error", "reference_path begins at start_position"),
    "reference-goal": Rule("error", "reference_path ends at a goal"),
    "reference-short": Rule("error", "a reference path has at least two points"),
    "goal-radius": Rule("error", "a goal's radius is a positive number of metres"),
    "missing-geodesic": Rule("warning", "info.geodesic_distance is what trainers filter by"),
    "geodesic-invalid": Rule("error", "a geodesic distance is finite and not negative; the goal may be unreachable"),
    "geodesic-too-short": Rule("error", "a path can't be shorter than the straight line: wrong goal, start or frame"),
    "start-is-goal": Rule("warning", "an agent that stops at once succeeds"),
    # against the navmesh
    "start-off-mesh": Rule("error", "snap the start to the navmesh of the agent's size"),
    "goal-off-mesh": Rule(
        "error", "snap goals to the navmesh: Habitat silently snaps an object's centre up to 4 m away"
    ),
    "unreachable": Rule("error", "start and goal lie on different islands: drop the episode"),
    "geodesic-differs": Rule("error", "the stored distance differs from the navmesh's: another navmesh, goal or start"),
    # text
    "empty-text": Rule("error", "an instruction needs words"),
    "token-range": Rule("error", "a token is an index into the vocabulary"),
    "token-length": Rule("error", "tokens of all instructions have one length: loaders stack them"),
    "token-mismatch": Rule("warning", "tokens are not those of the text under this vocabulary"),
    "unknown-words": Rule("warning", "words outside the vocabulary become UNK"),
    # ground truth
    "truth-missing": Rule("error", "nDTW raises KeyError for an episode without ground truth"),
    "truth-unused": Rule("warning", "no episode has this id"),
    "truth-empty": Rule("error", "locations need at least one point"),
    "truth-start": Rule("error", "locations begin at the episode's start"),
    "truth-goal": Rule("warning", "locations end outside the radius of every goal"),
    "truth-sparse": Rule("warning", "nDTW is too low with sparse references: densify them to 0.25 m"),
    "truth-steps": Rule("error", "there is one location more than forward_steps, which counts the 1s in actions"),
    "truth-actions": Rule("error", "actions are 0 to 3 and end with their only STOP"),
    # across files
    "scene-leak": Rule("error", "scenes of training, val_unseen and test must differ"),
    "episode-leak": Rule("error", "the same text from the same start is in two splits"),
    # discrete R2R
    "duplicate-viewpoint": Rule("warning", "a viewpoint is repeated in succession"),
    "heading-range": Rule("error", "headings are radians in [0, 2π)"),
    "unknown-viewpoint": Rule("error", "not an included viewpoint of the scan"),
    "path-disconnected": Rule("error", "two consecutive viewpoints are not connected in the scan's graph"),
    "distance-differs": Rule("error", "the stored distance differs from the path's length"),
}
"""Every code with its severity and remedy."""


@dataclass(frozen=True, order=True)
class Finding:
    """One finding at one place."""

    file: str
    place: str
    code: str
    message: str
    episode: str = ""
    """The episode's id, or a path's; empty for a finding about the whole file."""

    @property
    def severity(self) -> Severity:
        """The severity of the finding's code."""
        return CODES[self.code].severity

    @property
    def remedy(self) -> str:
        """The remedy of the finding's code."""
        return CODES[self.code].remedy

    def line(self) -> str:
        """Return ``file: place: code message``, in the usual form of linters."""
        place = f"{self.place}: " if self.place else ""
        return f"{self.file}: {place}{self.severity} [{self.code}] {self.message}"


class LintReport:
    """The findings of one file, in the order in which they were made."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.episode = ""
        """Id of the episode that is being checked."""
        self._findings: list[Finding] = []

    def add(self, place: str, code: str, message: str) -> None:
        """Add a finding."""
        assert code in CODES, code
        self._findings.append(Finding(self.file, place, code, message, self.episode))

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._findings)
