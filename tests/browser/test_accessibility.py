"""An automatic audit (axe-core) of every view, light and dark, wide and narrow: nothing serious."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from tests.browser.conftest import Run
from tests.browser.driver import Page

AUDIT = """const done = arguments[0];
axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']}).then(
    (found) => done([found.passes.length, found.violations.map((one) =>
        [one.impact, one.id, one.nodes.map((node) => node.html.slice(0, 160) + ' ' + node.failureSummary)])]))"""


def audit(page: Page) -> tuple[int, list[Any]]:
    """Return the number of rules that hold, and those that do not with their elements."""
    page.run(files("axe_core_python").joinpath("axe.min.js").read_text())
    passes, found = page.driver.execute_async_script(AUDIT)
    return passes, found


def test_nothing_serious_is_found(page: Page, made: Run) -> None:
    episode = min(made.manifest)
    addresses = ("browse", f"episode/{episode}", "group/0", "statistics", "agents", "scenes", "help")
    scene, source = made.ask("select scene_id, source from scenes order by 1")[0]
    counts = []
    for dark, width in ((False, 1280), (True, 390)):
        page.dark(dark)
        page.size(width)
        for address in (*addresses, f"scene/{source}%2F{scene.replace('/', '%2F')}"):
            page.open(f"#/{address}")
            if address.startswith("episode"):
                page.one(".tree [data-condition]").click()
            passes, found = audit(page)
            counts.append(passes)
            assert [one for one in found if one[0] in ("serious", "critical")] == [], (address, dark)
            if found:
                print(f"\naxe, {address}: {[(impact, rule, len(nodes)) for impact, rule, nodes in found]}")
    assert min(counts) > 15
    print(f"\naxe-core: 0 serious issues in {len(counts)} states, {min(counts)} to {max(counts)} rules hold in each")
