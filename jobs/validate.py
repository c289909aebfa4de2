"""``condvln verify --lint``: lint files of episodes, from CondVLN or elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from condvln.export.validation import CODES, EpisodeNavmeshes, Finding, Options, validate
from condvln.navigation.graph_pathfinder import GraphFolder

__all__ = ["ValidationReport", "validate_files"]

_FAILED: Final = 3
_KINDS: Final = {
    "vlnce": "episodes of VLN-CE",
    "ansr": "of ANSR-v1",
    "rxr": "of RxR",
    "r2r": "paths of R2R",
    "truth": "ground truths",
}


@dataclass(frozen=True)
class ValidationReport:
    """Findings of one run of the linter, printed one per line so that they can be searched."""

    findings: tuple[Finding, ...]
    navmeshes: EpisodeNavmeshes
    checked: Options
    graphs: CountedGraphs

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
        checked = self.checked
        kinds = [f"{checked.entries[kind]:,} {what}" for kind, what in _KINDS.items() if checked.entries[kind]]
        lines.append(
            f"checked: {len(checked.files)} files with {', '.join(kinds) or 'no episode'}"
            if checked.files
            else "checked: nothing, as the export has no file of episodes or paths"
        )
        lines += self.graphs.lines()
        found, lacking = len(self.navmeshes.checked), self.navmeshes.lacking
        if not found and not lacking:
            lines.append(
                "not checked: geometry, as no file has episodes on a navmesh; texts without an episode, which are in "
                "the store alone. condvln verify CONFIG proves texts, and paths over viewpoints"
            )
        else:
            scene, why = min(lacking.items(), default=("", ""))
            others = f", {len(lacking)} not, such as {scene}: {why}" if lacking else ""
            lines.append(f"{found} scenes checked against their navmesh{others}")
        return "\n".join(lines) + "\n"

    def as_json(self) -> dict[str, Any]:
        """Return the findings as records."""
        return {
            "findings": [
                {**asdict(finding), "severity": finding.severity, "remedy": finding.remedy} for finding in self.findings
            ],
            "files": self.checked.files,
            "entries": dict(self.checked.entries),
            "graphs": {"checked": dict(self.graphs.checked), "lacking": dict(self.graphs.without)},
            "navmeshes": {"checked": sorted(self.navmeshes.checked), "lacking": self.navmeshes.lacking},
            "exit_code": self.exit_code,
        }


class CountedGraphs(GraphFolder):
    """Counts the paths of R2R files whose scan has a graph in the folders, and those without, by scan."""

    def __init__(self, *folders: Path) -> None:
        super().__init__(*folders)
        self.checked: Counter[str] = Counter()
        self.without: Counter[str] = Counter()

    def get(self, scan: str, default: Any = None) -> Any:
        """Return the graph of one path's scan."""
        (self.checked if scan in self else self.without)[scan] += 1
        return super().get(scan, default)

    def lines(self) -> list[str]:
        """Return how many paths were checked along the edges of their graphs, and how many were not."""
        lines = []
        if self.checked:
            lines.append(
                f"{self.checked.total():,} paths of {len(self.checked)} scans checked along their scan's graph: "
                "viewpoints, edges, lengths"
            )
        if self.without:
            lines.append(
                f"{self.without.total():,} paths of {len(self.without)} scans not checked along a graph, such as "
                f"{min(self.without)}: no {min(self.without)}_connectivity.json in the folders of --connectivity"
            )
        return lines


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
    counted = CountedGraphs(*graphs)
    options = Options(pathfinder_of=navmeshes, graphs=counted)
    return ValidationReport(tuple(validate(path, options)), navmeshes, options, counted)
