"""``condvln navmesh``: build, inspect, compare and draw navmeshes."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from condvln.formats.streams import write_figure
from condvln.navigation.navmesh_file import read_navmesh, write_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.settings import NavMeshSettings
from jobs.report import Report, Section
from schemas.errors import UsageError

__all__ = ["build", "compare", "info", "picture", "settings_of"]

ISLAND_COLOURS: Final = ("#7fb3d5", "#f5b041", "#82c785", "#d98880", "#a9a4d0", "#cdb38b")


def settings_of(pairs: Sequence[str]) -> NavMeshSettings:
    """Return Habitat's default navmesh settings, changed by ``name=value`` pairs. Raises UsageError on an unknown name
    or a bad value.
    """
    settings = NavMeshSettings()
    kinds = {f.name: type(getattr(settings, f.name)) for f in fields(settings)}
    for pair in pairs:
        name, _, text = pair.partition("=")
        if name not in kinds:
            raise UsageError(f"no navmesh setting is called {name!r}", remedy=f"Choose one of: {', '.join(kinds)}.")
        if kinds[name] is bool:
            if text not in ("true", "false"):
                raise UsageError(f"{name} must be true or false, got {text!r}")
            value: Any = text == "true"
        else:
            try:
                value = float(text)
            except ValueError:
                raise UsageError(f"{name} must be a number, got {text!r}") from None
        settings = replace(settings, **{name: value})
    return settings


def build(mesh: Path, out: Path, settings: NavMeshSettings, profile: str, console: Console) -> Report:
    """Build the navmesh that Habitat would build of `mesh`, and write it to `out`."""
    # Here and below: who asks for one verb waits for what that verb needs, not for the others' libraries.
    from condvln.navigation.recast import build_scene_navmesh

    navmesh = build_scene_navmesh(
        mesh, settings, profile, report=lambda stage: console.print(stage, highlight=False, markup=False)
    )
    write_navmesh(out, navmesh)
    return info(out)


def info(path: Path) -> Report:
    """Report settings, size and islands of a ``.navmesh`` file."""
    navmesh = read_navmesh(path)
    pathfinder = Pathfinder(navmesh)
    low, high = pathfinder.bounds
    islands = [
        {"index": k, "radius": pathfinder.island_radius(k), "area": pathfinder.island_area(k)}
        for k in range(pathfinder.num_islands)
    ]
    document: dict[str, Any] = {
        "file": str(path),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "version": navmesh.version,
        "polygons": len(navmesh.tile.polys),
        "vertices": len(navmesh.tile.verts),
        "area": pathfinder.navigable_area,
        "bounds": [np.asarray(low, float).tolist(), np.asarray(high, float).tolist()],
        "settings": asdict(pathfinder.settings),
        "settings_in_file": navmesh.settings is not None,
        "islands": islands,
    }
    lines = [
        f"{path}: version {navmesh.version}, {document['polygons']} polygons, {document['vertices']} vertices,"
        f" {document['area']:.2f} m²",
        f"from ({', '.join(f'{v:.3f}' for v in low)}) to ({', '.join(f'{v:.3f}' for v in high)})",
    ]
    settings = Section("Settings", ("name", "value"), [*document["settings"].items()])
    rows = [(i["index"], i["radius"], i["area"]) for i in islands]
    return Report(document, lines, [settings, Section("Islands", ("island", "radius, m", "area, m²"), [*rows])])


def compare(first: Path, second: Path) -> Report:
    """Report the first build stage at which two navmeshes differ; exit code 3 if they do."""
    from condvln.navigation.navmesh_file import compare_navmeshes

    found = compare_navmeshes(read_navmesh(first), read_navmesh(second))
    if found is None:
        return Report({"equal": True}, ["equal, byte for byte"])
    document = {"equal": False, **{name: str(value) for name, value in asdict(found).items()}}
    return Report(document, [f"they first differ at {found}"], exit_code=3)


def picture(path: Path, out: Path) -> Report:
    """Draw a top-down PNG of a navmesh, each island in its own colour."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    pathfinder = Pathfinder.load(path)
    corners = pathfinder.navmesh.tile.outlines()
    middles = np.array([polygon.mean(axis=0) for polygon in corners])
    islands = pathfinder.get_islands(middles)
    figure = Figure(figsize=(10, 10), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.add_collection(
        PolyCollection(
            [polygon[:, [0, 2]] for polygon in corners],
            facecolors=[ISLAND_COLOURS[k % len(ISLAND_COLOURS)] for k in islands],
            edgecolors="white",
            linewidths=0.4,
        )
    )
    axes.autoscale()
    axes.set_aspect("equal")
    axes.invert_yaxis()  # north (−Z) is up
    axes.set_xlabel("x, metres (east →)")
    axes.set_ylabel("z, metres (north ↑)")
    axes.set_title(f"{path.name} · {len(corners)} polygons · {pathfinder.navigable_area:.1f} m²")
    write_figure(figure, out, dpi=120)
    return Report({"picture": str(out)}, [f"drawn to {out}"])
