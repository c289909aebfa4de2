"""The gallery of the documentation: its pictures are of such a page. ``CONDVLN_GALLERY=1`` renews them."""

from __future__ import annotations

import io
import os
import re
from pathlib import Path

import numpy as np
from PIL import Image

from tests.browser.conftest import Run
from tests.browser.driver import Page

SIZE = (1280, 860)
COLOURS = 64


def views(made: Run) -> dict[str, str]:
    """Return the addresses of the pictures by name."""
    seen = sorted({path.name.rsplit("-", 1)[0] for path in (made.page / "frames").glob("*.png")} & made.manifest.keys())
    rows = [made.manifest[name] for name in seen if made.manifest[name]["split"] == made.split]
    false = next(row for row in rows if not row["program"]["conditions"][0]["truth"])
    scene = f"{false['source']}%2F{false['scene_id']}"
    return {
        "agents": "#/agents",
        "episode": f"#/episode/{false['episode_id']}?mark=A",
        "group": "#/group/0",
        "scenes": "#/scenes",
        "scene": f"#/scene/{scene}?object={false['leaves'][0]['object_id']}",
        "statistics": "#/statistics",
    }


def test_the_gallery_shows_the_page(page: Page, made: Run, repository: Path) -> None:
    folder = repository / "docs" / "gallery"
    text = (repository / "docs" / "gallery.md").read_text(encoding="utf-8")
    wanted = views(made)
    assert re.findall(r"\]\(gallery/(\w+)\.png\)", text) == [*wanted]
    for name, address in wanted.items():
        page.open(address)
        page.size(*SIZE)
        page.until("return [...document.images].every((one) => one.complete)")
        with Image.open(io.BytesIO(page.driver.get_screenshot_as_png())) as taken:
            shown = taken.convert("RGB")
        if os.environ.get("CONDVLN_GALLERY"):
            folder.mkdir(exist_ok=True)
            shown.quantize(COLOURS).save(folder / f"{name}.png", optimize=True)
        with Image.open(folder / f"{name}.png") as kept:
            assert kept.size == shown.size == SIZE
            small = [np.asarray(one.convert("L").resize((64, 43)), np.float64) for one in (kept, shown)]
        assert np.abs(small[0] - small[1]).mean() < 12, f"{name} is of another page: renew it with CONDVLN_GALLERY=1"
