"""``condvln export --validate``: lint files of episodes, from CondVLN or elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from condvln.export.validation import CODES, Finding, Options, validate
from condvln.export.validation.navmeshes import EpisodeNavmeshes
from condvln.navigation.graph_pathfinder import GraphFolder

__all__ = ["ValidationReport", "validate_files"]

_FAILED: Final = 3


@dataclass(frozen=True)
class ValidationReport:
    """Findings of one run of the linter, printed one per line so that they can be searched."""

    findings: tuple[Finding, ...]
    navmeshes: EpisodeNavmeshes

    @property
    def exit_code(self) -> int:
        """Return 3 if a finding is an error, else 0."""
        return _FAILED if any(finding.severity == "error" for finding in self.findings) else 0

    def as_text(self) -> str:
        """Format the findings, then what each kind means and how often it occurs."""
        counts = Counter(finding.code for finding in self.findings)
        severities = Counter(finding.severity for finding in self.findings)
        lines = [finding.line() for finding in self.findings]
        if counts:
            lines += ["", *(f"{count:6} {code}: {CODES[code].remedy}" for code, count in sorted(counts.items())), ""]
        lines.append(f"{severities['error']} errors, {severities['warning']} warnings")
        lines += self._navmesh_lines()
        return "\n".join(lines) + "\n"

    def _navmesh_lines(self) -> list[str]:
        found, lacking = len(self.navmeshes.checked), self.navmeshes.lacking
        if not lacking:
            return [f"{found} scenes checked against their navmesh"]
        scene, why = next(iter(sorted(lacking.items())))
        return [f"{found} scenes checked against their navmesh, {len(lacking)} not, such as {scene}: {why}"]

    def as_json(self) -> dict[str, Any]:
        """Return the findings as records."""
        return {
            "findings": [
                {
                    "file": finding.file,
                    "place": finding.place,
                    "episode": finding.episode,
                    "code": finding.code,
                    "severity": finding.severity,
                    "message": finding.message,
                    "remedy": finding.remedy,
                }
                for finding in self.findings
            ],
            "navmeshes": {"checked": sorted(self.navmeshes.checked), "lacking": self.navmeshes.lacking},
            "exit_code": self.exit_code,
        }


def validate_files(path: Path, navmesh_roots: Sequence[Path] = (), graphs: Sequence[Path] = ()) -> ValidationReport:
    """Lint a file, or all files of the known formats below a folder.

    Parameters
    ----------
    navmesh_roots : folders of datasets; geometry is checked where a scene's navmesh is below one, or in the export
    graphs : folders of ``<scan>_connectivity.json``, for R2R files

    Raises
    ------
    UsageError : there is no such file
    """
    navmeshes = EpisodeNavmeshes(path, navmesh_roots)
    options = Options(pathfinder_of=navmeshes, graphs=GraphFolder(*graphs))
    return ValidationReport(tuple(validate(path, options)), navmeshes)
