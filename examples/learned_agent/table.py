"""Tables of scores and curves of losses: ``python table.py OUT SVG``; OUT is the folder of repeat.sh."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

SHOWN = {"success": "SR", "csr_all": "CSR-all", "bsa_all": "BSA-all", "spl": "SPL", "spl_look": "SPL-look"}
SHOWN |= {"justified": "justified", "leaf_correct": "right leaf", "wrong_branch": "wrong branch"}
COLOURS = {"direct": "#c0392b", "looking": "#1f6f8b"}


def interval(values: np.ndarray, scenes: np.ndarray) -> str:
    """Return the mean in percent with its 95 % interval over scenes (bootstrap); seeds of one scene stay together."""
    kept = ~np.isnan(values)
    if not kept.any():
        return "–"
    _, of = np.unique(scenes[kept], return_inverse=True)
    sums, counts = np.bincount(of, values[kept]), np.bincount(of)
    drawn = np.random.default_rng(0).integers(0, len(sums), (2000, len(sums)))
    low, high = np.percentile(100 * sums[drawn].sum(1) / counts[drawn].sum(1), (2.5, 97.5))
    return f"{100 * sums.sum() / counts.sum():.1f} ({low:.0f}–{high:.0f})"


def rows_of(out: Path) -> list[dict]:
    """Return the scores of all agents, with the kind of walks that a network was trained on and the group."""
    rows = []
    for test in ("made", "real"):
        manifest = (out / f"{test}_test/export/manifest/test.jsonl").read_text().splitlines()
        groups = {str(one["episode_id"]): one["group_id"] for one in map(json.loads, manifest)}
        for line in (out / f"scores/{test}.jsonl").read_text().splitlines():
            row = json.loads(line)
            name, _, seed = row["agent"].rpartition("-")
            kind, seed = (f"{name} walks", seed) if seed.isdigit() else (row["agent"], "")
            row |= {"kind": kind, "seed": seed, "test": test, "group": groups[str(row["episode_id"])]}
            row |= {"scene": f"{test}/{row['scene_id']}", "where": row["observability"][:2]}  # O0f is a part of O0
            rows.append(row)
    return rows


def table(rows: list[dict], slices: dict[str, dict[str, str]], kinds: list[str]) -> None:
    """Print a Markdown table: a row for each slice and agent."""
    print("| episodes | agent | n |", " | ".join(SHOWN.values()), "|")
    print("|" + "---|" * (3 + len(SHOWN)))
    for name, wanted in slices.items():
        for kind in kinds:
            own = [row for row in rows if row["kind"] == kind and all(row[k] == v for k, v in wanted.items())]
            scenes = np.array([row["scene"] for row in own])
            numbers = [np.array([row[key] for row in own], float) for key in SHOWN]
            if own:
                count = len({row["episode_id"] for row in own})
                print(f"| {name} | {kind} | {count} |", " | ".join(interval(one, scenes) for one in numbers), "|")


def groups(rows: list[dict], kinds: list[str]) -> None:
    """Print the share of whole counterfactual groups in which every episode succeeded, or ended at the right leaf."""
    for kind in kinds:
        found: dict[tuple, list[dict]] = {}
        for row in rows:
            if row["kind"] == kind and row["group"]:
                found.setdefault((row["seed"], row["group"]), []).append(row)
        whole = [one for one in found.values() if len(one) == 4]
        scenes = np.array([one[0]["scene"] for one in whole])
        shares = [
            interval(np.array([min(row[key] for row in one) for one in whole], float), scenes)
            for key in ("success", "leaf_correct")
        ]
        print(f"| {kind} | {len(whole)} | {' | '.join(shares)} |")


def curves(out: Path, svg: Path) -> None:
    """Draw the loss by epoch, in training (thin) and on walks in other houses (thick)."""
    logs = {path.parent.name: json.loads(path.read_text()) for path in sorted(out.glob("nets/*/log.json"))}
    most, epochs = 1.4, max(len(log) for log in logs.values())
    parts = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 340" font-family="sans-serif" font-size="13">']
    parts.append('<rect width="640" height="340" fill="white"/><text x="560" y="330">epoch</text>')
    for level in np.arange(0.2, most + 0.01, 0.2):
        y = 290 - 260 * level / most
        parts.append(f'<path d="M60 {y:.0f}H610" stroke="#ddd"/><text x="28" y="{y + 4:.0f}">{level:.1f}</text>')
    for epoch in range(1, epochs + 1, 1 + epochs // 20):
        parts.append(f'<text x="{55 + 550 * (epoch - 1) / (epochs - 1):.0f}" y="310">{epoch}</text>')
    for name, log in logs.items():
        colour = COLOURS[name.rpartition("-")[0]]
        for key, width in (("loss", 1), ("held_out_loss", 2.5)):
            line = " ".join(
                f"{60 + 550 * k / (epochs - 1):.1f},{290 - 260 * min(row[key], most) / most:.1f}"
                for k, row in enumerate(log)
            )
            parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}"/>')
    for k, (name, colour) in enumerate(COLOURS.items()):
        parts.append(f'<text x="430" y="{40 + 18 * k}" fill="{colour}">{name} walks</text>')
    parts.append('<text x="60" y="20">loss: thin in training, thick in other houses</text></svg>')
    svg.write_text("\n".join(parts) + "\n")


def main(out: Path, svg: Path) -> None:
    """Print all tables and draw the curves."""
    rows = rows_of(out)
    nets = [f"{name} walks" for name in COLOURS]  # condvln walk has an agent called looking
    kinds = [*nets, *sorted({row["kind"] for row in rows} - {*nets})]
    table(rows, {"all": {}, "made houses": {"test": "made"}, "ProcTHOR": {"test": "real"}}, kinds)
    table(rows, {name: {"where": name} for name in ("O0", "O1", "O2")}, kinds)
    table(rows, {name: {"category": name} for name in ("simple", "nested", "chain")}, kinds)
    groups(rows, kinds)
    curves(out, svg)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
