"""What a report on a build of a benchmark says: the yield of its sources, its cells, and what it lacks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from jobs.report import Section
from schemas.benchmark import BenchmarkFile, BenchmarkRecord
from schemas.config import Config

__all__ = ["cell_table", "part_lines", "short_lines", "source_table", "stop_table"]


def source_table(file: BenchmarkFile, record: BenchmarkRecord) -> Section:
    """Return the table of the scenes, instructions and episodes of each family, beside the number of scenes that the
    run takes of whole copies.
    """
    rows = [(name, s.scenes, file.scenes.get(name), s.instructions, s.episodes) for name, s in record.sources.items()]
    return Section("Sources", ("source", "scenes", "taken of whole copies", "instructions", "episodes"), [*rows])


def short_lines(file: BenchmarkFile, record: BenchmarkRecord) -> Iterator[str]:
    """Yield report lines about what the benchmark lacks: the number of instructions if there are too few, and the cells
    of each split that are below the floor.
    """
    if record.instructions < file.instructions:
        yield f"SHORT: {record.instructions:,} instructions of {file.instructions:,}"
    for split in file.splits:
        cells = [cell for cell in record.cells if cell.split == split]
        short = [cell for cell in cells if cell.shortfall]
        empty = sorted({c.source for c in cells} - {c.source for c in cells if c.episodes})
        if not short:
            continue
        named = ", ".join(f"{c.source} {c.category} {c.episodes}" for c in short if c.source not in empty)
        none = f"; nothing from {', '.join(empty)}" if empty else ""
        yield (
            f"SHORT: split {split}: {len(short)} of {len(cells)} cells have fewer than {file.floor} episodes"
            f"{': ' if named else ''}{named}{none}"
        )


def part_lines(file: BenchmarkFile, record: BenchmarkRecord) -> list[str]:
    """Return a report line about the families of which scenes are missing, and one about scenes that are there and
    were quarantined or skipped; no line where there are none.
    """
    here = Counter(scene.partition("/")[0] for scene in record.scenes)
    parts = [f"{name} {here[name]} of {whole} scenes" for name, whole in file.scenes.items() if here[name] < whole]
    refused = Counter(
        (scene.partition("/")[0], found.status) for scene, found in record.scenes.items() if found.status != "ok"
    )
    lines = []
    if parts:
        lines.append(
            "a build of a part of the scenes, so its snapshot id differs from that of a whole build: "
            f"{', '.join(parts)}"
        )
    if refused:
        told = [f"{family} {number} {status}" for (family, status), number in sorted(refused.items())]
        lines.append(f"scenes without rows: {', '.join(told)}")
    return lines


def cell_table(file: BenchmarkFile, record: BenchmarkRecord) -> Section:
    """Return the table of the number of episodes by split and source; a number below the floor is given "of" it."""
    found = {(cell.split, cell.source, cell.category): cell for cell in record.cells}
    categories = [*dict.fromkeys(cell.category for cell in record.cells)]
    rows = []
    for split, source in dict.fromkeys((cell.split, cell.source) for cell in record.cells):
        cells = [found.get((split, source, category)) for category in categories]
        told = [None if c is None else f"{c.episodes} of {file.floor}" if c.shortfall else c.episodes for c in cells]
        rows.append((split, source, *told))
    return Section("Episodes", ("split", "source", *categories), [*rows])


def stop_table(config: Config, record: BenchmarkRecord) -> Section:
    """Return the table of the shares of leaves with no, one and two stops before their goal, beside those asked."""
    sampling, rows = config.sampling, []
    for one in record.stops:
        asked = sampling.moves if one.leaves < 4 else (*sampling.moves_four_leaves, 0.0)
        shares = [f"{100 * count / sum(one.stops):.1f}" for count in one.stops]
        told = " / ".join(f"{100 * share:g}" for share in asked)
        rows.append((one.split, one.leaves, sum(one.stops), " / ".join(shares), told))
    columns = ("split", "leaves of a program", "leaves in all", "none / one / two, %", "asked")
    return Section("Stops before the goal", columns, [*rows])
