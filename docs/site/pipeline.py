"""Draw ``docs/pipeline.svg``, the figure of the pipeline: ``python docs/site/pipeline.py``.

Stages and tables are those of ``jobs.pipeline``, so that a test finds the figure out of date when they change.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

from jobs.pipeline import build_pipeline
from schemas.config import Config, SourceConfig

FILE = Path(__file__).resolve().parents[1] / "pipeline.svg"

WORK = {
    "scene": ("condvln/sources", "rooms and objects"),
    "counts": ("condvln/instructions", "how often what is true"),
    "relations": ("condvln/relations", "distances, predicates"),
    "visibility": ("condvln/episodes", "what can be seen"),
    "episodes": ("condvln/episodes", "decision trees, paths"),
    "text": ("condvln/instructions", "words"),
}
"""The folder of each stage's code, and what the stage finds."""

BOX, GAP, LEFT = 150, 30, 65


def box(x: float, y: float, width: float, height: float, lines: list[str], colour: str) -> str:
    """Return a rounded box; the first line is its title."""
    parts = [f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{colour}" stroke="#37474f"/>']
    for number, line in enumerate(lines):
        style = 'font-weight="bold" font-size="15"' if number == 0 else 'font-size="12"'
        at = y + 22 + 17 * number
        parts.append(f'<text x="{x + width / 2}" y="{at}" text-anchor="middle" {style}>{escape(line)}</text>')
    return "".join(parts)


def arrow(*points: tuple[float, float], dashed: bool = False) -> str:
    """Return a line through points with an arrow head at its end."""
    path = " ".join(f"{x},{y}" for x, y in points)
    dashes = ' stroke-dasharray="5 4"' if dashed else ""
    return (
        f'<polyline points="{path}" fill="none" stroke="#37474f" stroke-width="1.5" marker-end="url(#head)"{dashes}/>'
    )


def label(x: float, y: float, text: str, anchor: str = "middle") -> str:
    """Return a line of small text."""
    return f'<text x="{x}" y="{y}" font-size="12" text-anchor="{anchor}">{escape(text)}</text>'


def figure() -> str:
    """Return the SVG: dataset files, the stages of one scene, the store, and its readers."""
    root = Path("data")
    pipeline = build_pipeline(
        Config(name="figure", store=root, sources=(SourceConfig(family="replicacad", root=root),))
    )
    parts = []
    across = len(pipeline.stages) * (BOX + GAP) - GAP
    column = {stage.name: LEFT + at * (BOX + GAP) for at, stage in enumerate(pipeline.stages)}
    parts.append(box(LEFT, 20, BOX, 64, ["native files", "ReplicaCAD, ProcTHOR,", "Matterport3D, …"], "#eceff1"))
    parts.append(arrow((LEFT + BOX / 2, 84), (LEFT + BOX / 2, 138)))
    priors = column["episodes"]
    parts.append(box(priors, 20, BOX, 64, ["priors", "labels usual in a room,", "over all scenes"], "#fff3e0"))
    parts.append(
        arrow(
            (column["counts"] + BOX - 20, 138),
            (column["counts"] + BOX - 20, 110),
            (priors - 20, 110),
            (priors - 20, 52),
            (priors - 2, 52),
            dashed=True,
        )
    )
    parts.append(arrow((priors + BOX / 2, 84), (priors + BOX / 2, 138), dashed=True))
    parts.append(
        f'<rect x="{LEFT - 25}" y="125" width="{across + 50}" height="165" rx="10" '
        'fill="none" stroke="#90a4ae" stroke-dasharray="3 3"/>'
    )
    parts.append(
        label(LEFT + across, 118, "each scene is worked on in a Ray task; each stage is kept under a key", "end")
    )
    for at, stage in enumerate(pipeline.stages):
        x = column[stage.name]
        parts.append(box(x, 140, BOX, 64, [stage.name, *WORK[stage.name]], "#e0f2f1"))
        if at:
            parts.append(arrow((x - GAP, 172), (x - 2, 172)))
        tables = [name for name in pipeline.tables if name in stage.tables]
        for number, name in enumerate(tables):
            parts.append(label(x + BOX / 2, 236 + 17 * number, name))
        if tables:
            parts.append(arrow((x + BOX / 2, 204), (x + BOX / 2, 220)))
    middle = LEFT + across / 2
    parts.append(arrow((middle, 290), (middle, 328)))
    stored = ["store: units, snapshots, refs", "Parquet tables; a ref moves to a snapshot in one step"]
    parts.append(box(middle - 200, 330, 400, 50, stored, "#e3f2fd"))
    readers = {
        "query, show": ["DuckDB, pictures,", "any Parquet reader"],
        "export": ["VLN-CE, R2R, RxR,", "splits and manifests"],
        "bias": ["can the right leaf be", "guessed unseen?"],
        "verify": ["proof from text and", "native files alone"],
        "walk": ["an agent, here or in", "a simulator"],
        "evaluate": ["SR, SPL, nDTW, BSA,", "CSR, branch taken"],
    }
    top, under = 430, 520
    place = {name: LEFT + number * (BOX + GAP) for number, name in enumerate(readers)}
    for name, lines in readers.items():
        parts.append(box(place[name], top, BOX, 64, [name, *lines], "#f3e5f5"))
    for name in ("query, show", "export"):
        down = place[name] + BOX / 2
        parts.append(arrow((middle - 200, 355), (down, 355), (down, top - 2)))
    export = place["export"] + BOX / 2
    for name in ("bias", "verify", "walk", "evaluate"):
        up = place[name] + BOX / 2
        parts.append(arrow((export, top + 64), (export, under), (up, under), (up, top + 66)))
    parts.append(arrow((place["walk"] + BOX, top + 32), (place["evaluate"] - 2, top + 32)))
    head = (
        '<defs><marker id="head" markerWidth="9" markerHeight="9" refX="8" refY="4" orient="auto">'
        '<path d="M0,0 L9,4 L0,8 z" fill="#37474f"/></marker></defs>'
    )
    width, height = across + 2 * LEFT, under + 20
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="sans-serif" role="img" aria-label="The pipeline of CondVLN">'
        f'<rect width="{width}" height="{height}" fill="white"/>{head}\n' + "\n".join(parts) + "\n</svg>\n"
    )


if __name__ == "__main__":
    FILE.write_text(figure(), encoding="utf-8")
