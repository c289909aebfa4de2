"""The page in a real Chromium, from the disk: filters, links, hovers, keys and playback act, and numbers are right."""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from pathlib import Path
from urllib.parse import parse_qs

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from tests.browser.conftest import AGENTS, Run
from tests.browser.driver import Page


def count(page: Page) -> int:
    """Return the number of episodes that the list shows."""
    return int(page.one("#count").get_attribute("data-count") or -1)


def choose(page: Page, name: str, value: str) -> None:
    """Set a filter as a person does, and wait for the list."""
    page.open("#/browse")
    field = page.one(f"[name='{name}']")
    before = page.run("return location.hash")
    if field.tag_name == "select":
        Select(field).select_by_value(value)
    else:
        field.send_keys(value + "\t")
    said = "document.getElementById('status').textContent.includes('episodes')"
    page.until(f"return location.hash !== arguments[0] && {said}", before)
    page.settle()


def test_each_filter_gives_what_duckdb_counts(page: Page, made: Run) -> None:
    total = made.ask("select count(*) from episodes")[0][0]
    assert count(page) == total
    for name in ("source", "category", "composition", "gold_label"):
        value, wanted = made.ask(f"select {name}, count(*) n from episodes group by 1 order by n, 1")[0]
        choose(page, name, value)
        assert count(page) == wanted, name
    exported = sum(row["split"] == made.split for row in made.manifest.values())
    choose(page, "split", made.split)
    assert count(page) == exported
    scene, source, wanted = made.ask("select scene_id, source, count(*) from episodes group by 1, 2 order by 1")[0]
    choose(page, "scene", f"{source}/{scene}")
    assert count(page) == wanted
    for name, low, high in (("route_length", 3, 7.5), ("words", 30, 60), ("moves", 2, 3)):
        choose(page, name, f"{low}..{high}")
        sql = f"select count(*) from episodes where round({name}, 2) between {low} and {high}"
        assert count(page) == made.ask(sql)[0][0], name
    for name in ("depth", "chain"):
        choose(page, name, "2")
        sql = f"select count(*) from episodes where {name} = 2"
        assert count(page) == made.ask(sql)[0][0], name
    choose(page, "observability", "O2")
    assert count(page) == made.ask("select count(*) from episodes where observability = 'O2'")[0][0]
    choose(page, "group", "any")
    assert count(page) == made.ask("select count(*) from episodes where group_id is not null")[0][0]
    asked = """select count(*) from episodes join instructions using (instruction_id, scene_id)
        where len(list_filter(conditions, lambda c: c.qualifier.predicate = 'near')) > 0"""
    choose(page, "predicate", "near")
    assert count(page) == made.ask(asked)[0][0]
    for value, sign in (("some", ">"), ("none", "=")):
        choose(page, "untrue", value)
        false = "len(list_filter(conditions, lambda c: not c.truth))"
        asked = (
            f"select count(*) from episodes join instructions using (instruction_id, scene_id) where {false} {sign} 0"
        )
        assert count(page) == made.ask(asked)[0][0], value
    label = made.ask("select conditions[1].label, count(*) n from instructions group by 1 order by n desc, 1")[0][0]
    named = f"""select count(*) from episodes e join instructions i using (instruction_id, scene_id) where
        len(list_filter(conditions, lambda c: c.label = '{label}' or
            len(list_filter(c.qualifier.anchors, lambda a: a.label = '{label}')) > 0)) > 0 or
        len(list_filter(i.leaves, lambda f: len(list_filter(f.moves, lambda m: m.label = '{label}' or
            len(list_filter(m.qualifier.anchors, lambda a: a.label = '{label}')) > 0)) > 0)) > 0"""
    choose(page, "label", label)
    assert count(page) == made.ask(named)[0][0]


def test_search_finds_words_and_ids(page: Page, made: Run) -> None:
    choose(page, "q", "If THERE")
    wanted = "select count(*) from episodes where contains(lower(instruction_text), 'if there')"
    assert count(page) == made.ask(wanted)[0][0] > 0
    some = made.ask("select episode_id from episodes order by 1")[0][0]
    choose(page, "q", str(some))
    assert page.texts(".episodes .id") == [str(some)]


def test_outcomes_of_agents_are_filters_and_links(page: Page, made: Run) -> None:
    own = sum(row["split"] == made.split for row in made.manifest.values())
    page.go("#/agents")
    table = {row[0]: row[1:] for row in (row.split("|") for row in cells(page, "outcomes"))}
    assert set(table) == set(AGENTS)
    assert all(sum(map(int, row)) == own for row in table.values())
    assert table["perfect"][0] == str(own)
    link = page.one("[data-table='outcomes'] tbody a")
    wanted = int(link.text)
    link.click()
    page.until("return location.hash.startsWith('#/browse') && Boolean(document.getElementById('count'))")
    assert count(page) == wanted


def walks_drawn(page: Page) -> list[str]:
    """Return the agents whose walks are on the plan of the episode that is shown."""
    page.until("return location.hash.startsWith('#/episode/') && document.querySelector('.playback input[data-agent]')")
    page.until("return Boolean(document.querySelector('.plan-holder .walk'))")
    script = "return [...document.querySelectorAll('input[data-agent]:checked')].map((box) => box.dataset.agent)"
    return [*page.run(script)]


def test_an_agents_walk_is_at_most_three_clicks_from_the_first_page(page: Page) -> None:
    page.go("#/browse")
    agent = AGENTS[-1]
    page.one(".episodes .outcome[href*='walk=always-then']").click()
    assert walks_drawn(page) == [agent]
    before = page.run("return document.body.dataset.ready")
    page.one("#next").click()
    page.until("return document.body.dataset.ready !== arguments[0]", before)
    assert walks_drawn(page) == [agent], "the next episode of the list has its walk too"
    page.go("#/browse")
    page.one("header nav a[data-view='agents']").click()
    page.until("return Boolean(document.querySelector('[data-table=main-first]'))")
    page.one("[data-table='main-first'] a[href*='always-then']").click()
    page.until("return Boolean(document.querySelector('.episodes [data-episode]'))")
    assert count(page) == count_of_agent(page, agent)
    page.one(".episodes [data-episode]").click()
    assert walks_drawn(page) == [agent]


def count_of_agent(page: Page, agent: str) -> int:
    """Return the number of episodes for which an agent has an outcome."""
    script = "return explorer.index.agents.find((one) => one.name === arguments[0]).outcome.filter(Boolean).length"
    return int(page.run(script, agent))


def test_an_agent_that_committed_to_no_leaf_is_told_how_far_it_was(page: Page) -> None:
    page.go("#/browse")
    name = page.run("""
        const [agent] = explorer.index.agents;
        const row = agent.outcome.findIndex(Boolean);
        agent.outcome[row] = explorer.index.outcomes.indexOf("no commit");
        Object.assign(agent.scores, { committed_leaf: [], navigation_error: [] });
        agent.scores.navigation_error[row] = 1.5;
        return explorer.index.columns.id[row];""")
    page.go(f"#/episode/{name}")
    row = next(row for row in cells(page, "agents-here") if row.startswith("perfect|"))
    assert row.split("|")[1] == "no commit 1.50 m from the nearest goal point of the gold leaf"


def test_failures_and_differences_of_agents_are_filters(page: Page, made: Run) -> None:
    page.go("#/agents")
    table = {row[0]: row[1:] for row in (row.split("|") for row in cells(page, "outcomes"))}
    for agent in AGENTS:
        choose(page, f"agent:{agent}", "not success")
        assert count(page) == sum(map(int, table[agent][1:])), agent
    choose(page, "differ", "outcome")
    assert len(page.all(".episodes .outcomes")) == min(count(page), 50) > 0
    became = """return [...document.querySelectorAll('.episodes .outcomes')].map((row) =>
        [...row.children].map((one) => one.textContent.split(': ')[1]))"""
    assert all(len(set(row)) > 1 for row in page.run(became))


def test_scenes_say_what_they_yield_and_can_be_sorted(page: Page, made: Run) -> None:
    page.go("#/scenes")
    heads = page.texts("[data-table='scenes'] thead th")
    assert {"wanted", "placed", "main reason for less", *(f"SR of {agent}" for agent in AGENTS)} <= set(heads)
    wanted = {
        f"{source}/{scene}": (str(w), str(p))
        for source, scene, w, p in made.ask(
            "select source, scene_id, sum(wanted), sum(placed) from funnel group by all"
        )
    }
    at = [heads.index("wanted"), heads.index("placed")]
    assert {row.split("|")[0]: tuple(row.split("|")[k] for k in at) for row in cells(page, "scenes")} == wanted
    for order in (-1, 1):
        page.all("[data-table='scenes'] thead button")[at[1]].click()
        placed = [int(row.split("|")[at[1]]) for row in cells(page, "scenes")]
        assert placed == sorted(placed, key=lambda value: order * value)
    page.all("[data-table='scenes'] tbody a")[0].click()
    page.one("#yield")
    name = page.one("h1").text.removeprefix("Scene ")
    source, scene = name.split("/", 1)
    rows = made.ask(
        f"select cell, wanted, candidates, placed from funnel where source = '{source}' and scene_id = '{scene}'"
    )
    shown = [row.split("|") for row in cells(page, "yield")]
    assert {tuple(row[:4]) for row in shown} == {(c.replace("_", " "), *map(str, row)) for c, *row in rows}
    assert all((row[4] == "–") == (int(row[3]) >= int(row[1])) for row in shown), (
        "a reason stands where some are missing"
    )


def test_five_questions_take_three_clicks(page: Page, made: Run) -> None:
    nav = "header nav a[data-view='{}']"
    # which agent is best? where do two agents differ?
    page.open("#/help")
    page.one(nav.format("agents")).click()
    assert page.one("[data-table='main-first'] b").is_displayed()
    page.one("[data-table='compared'] tbody a").click()
    page.until("return Boolean(document.getElementById('count'))")
    assert count(page) > 0
    # which scenes fail, and why?
    page.one(nav.format("scenes")).click()
    page.one("[data-table='scenes'] tbody a").click()
    assert page.one("#yield").is_displayed()
    # why is this condition false? what did this agent see when it decided?
    page.open("#/browse?untrue=some&pictures=some")
    page.one(".episodes a").click()
    page.one(".tree [data-condition] .false").click()
    assert page.one(".verdict").text.startswith("✘ False")
    captions = page.texts(".seen-frames figcaption")
    assert any(
        re.search(r"^agent \S+, step \d+: as near as it comes to where [A-H] is decided$", one) for one in captions
    )


def test_a_plan_can_be_zoomed_and_marked_names_stand_once(page: Page, made: Run) -> None:
    name, k = relational(made, True)
    page.go(f"#/episode/{name}?mark={'ABCDEFGH'[k]}")
    names = "return [...document.querySelectorAll('.plan-holder .marked-label')].map((node) => node.textContent).sort()"
    doubled = """const shown = [...document.querySelectorAll('.plan .object-label:not(.off)')];
        return [...document.querySelectorAll('.marked-label')].filter((own) => shown.some((one) => one.textContent ===
            own.textContent && Math.abs(one.getBoundingClientRect().x - own.getBoundingClientRect().x) < 20)).length"""
    wide = "return document.querySelector('.plan .room').getBBox().width"
    rings = "return document.querySelectorAll('.layer-named .ring').length"
    ringed = page.run(rings)
    before, room = page.run(names), page.run(wide)
    page.one("[aria-label='Zoom in']").click()
    assert page.run(wide) == pytest.approx(1.6 * room, rel=0.01)
    assert page.run(doubled) == 0
    page.one("[aria-label='Show the whole plan']").click()
    assert page.run(wide) == pytest.approx(room, rel=0.01)
    assert page.run(names) == before
    page.size(1180)
    page.until("return document.querySelector('.plan').clientWidth < 700")
    assert page.run(rings) == ringed, "only small things have a ring, also when the plan is drawn afresh"


def objects(page: Page, kind: str) -> list[str]:
    """Return the sorted ids of the objects of the plan that are marked so."""
    script = "return [...document.querySelectorAll(`.object.${arguments[0]}`)].map((node) => node.dataset.object)"
    return sorted(page.run(script, kind))


def cells(page: Page, table: str) -> list[str]:
    """Return the rows of a table as texts of cells with bars between them."""
    script = """return [...document.querySelectorAll(`[data-table="${arguments[0]}"] tbody tr`)]
        .map((row) => [...row.children].map((cell) => cell.textContent.replaceAll(",", "")).join("|"))"""
    found: list[str] = page.run(script, table)
    return found


def test_statistics_equal_the_tables(page: Page, made: Run) -> None:
    page.go("#/statistics")
    crossed = made.ask("select source, category, count(*) from episodes group by 1, 2")
    head = page.texts("[data-table='source-category'] thead th")
    shown = {(row.split("|")[0], name): int(value) for row in cells(page, "source-category")
             for name, value in zip(head[1:-1], row.split("|")[1:-1], strict=True)}  # fmt: skip
    assert {key: value for key, value in shown.items() if value} == {(s, c): n for s, c, n in crossed}
    sums = "sum(wanted), sum(candidates), sum(rejected), sum(placed)"
    assert [tuple(row.split("|")) for row in cells(page, "funnel")] == [
        tuple(map(str, row)) for row in made.ask(f"select source, cell, {sums} from funnel group by 1, 2 order by 1, 2")
    ]
    rejected = made.ask("select source, stage, reason, sum(count) from rejections group by 1, 2, 3")
    assert {tuple(row.split("|")[:4]) for row in cells(page, "rejections")} == {tuple(map(str, r)) for r in rejected}
    relations = made.ask("""select source, predicate, count(*), count(*) filter (true_in_text) from relations
        where kind = 'semantic' group by 1, 2 order by 1, 2""")
    assert [tuple(row.split("|")) for row in cells(page, "relations")] == [tuple(map(str, row)) for row in relations]
    emitted = {(source, predicate) for source, predicate, *_ in relations}
    asked: defaultdict[str, list[bool]] = defaultdict(list)
    of_source = set()
    conditions = made.ask("""
        select e.source, coalesce(one.qualifier.predicate, 'presence'), one.truth
        from episodes as e join instructions as i using (source, scene_id, instruction_id),
        unnest(i.conditions) as unnested(one)""")
    for source, predicate, truth in conditions:
        asked[predicate].append(truth)
        of_source.add((source, predicate))
    names = page.texts("[data-bars='predicate'] li > :first-child")
    values = page.texts("[data-bars='predicate'] .value")
    assert {name: text.split(", ")[1] for name, text in zip(names, values, strict=True)} == {
        name.replace("_", " "): f"{math.floor(100 * sum(truths) / len(truths) + 0.5)} % true"
        for name, truths in asked.items()
    }
    links = page.all("[data-bars^='relations-'] a")
    parts = [parse_qs(str(link.get_attribute("href")).split("?")[1]) for link in links]
    linked = {(one["source"][0], one["predicate"][0]) for one in parts}
    assert linked == emitted & of_source, "a bar that leads to nothing is no link"
    assert made.config.export is not None
    gate = json.loads((made.config.export / "export.json").read_text())["bias"]
    if gate is not None:
        assert page.one("[data-gate]").get_attribute("data-gate") == ("passed" if gate["passed"] else "failed")


def relational(made: Run, truth: bool) -> tuple[str, int]:
    """Return an exported episode with a relational condition of this truth, and the condition's number."""
    for name, row in sorted(made.manifest.items()):
        for k, condition in enumerate(row["program"]["conditions"]):
            qualifier = condition["qualifier"]
            if condition["truth"] is truth and qualifier is not None and qualifier["predicate"] in ("near", "far from"):
                return name, k
    pytest.fail("no such episode was made")


def test_a_condition_shows_its_witness_and_measure(page: Page, made: Run) -> None:
    name, k = relational(made, True)
    row = made.manifest[name]
    condition = row["program"]["conditions"][k]
    page.go(f"#/episode/{name}")
    page.hover(f".tree [data-condition='{k}']")
    assert objects(page, "witness") == sorted(condition["witnesses"])
    anchor = condition["qualifier"]["anchors"][0]["object_id"]
    assert objects(page, "anchor") == [anchor]
    sql = f"""select used_distance from relations where scene_id = '{row["scene_id"]}' and kind = 'canonical'
        and source = '{row["source"]}' and subject = '{condition["witnesses"][0]}' and target = '{anchor}'"""
    shown = next(line for line in cells(page, "facts") if f"({condition['witnesses'][0]}) witness|distance" in line)
    used = made.ask(sql)[0][0]
    assert f"|{used:.2f} m|" in shown
    verdict = page.one(".verdict").text
    assert verdict.startswith("✔ True: ")
    assert re.search(r"so it is true, by \d+\.\d\d m\.$", verdict)
    # Where a condition has several witnesses or anchors, the numbers are said to be those of the first.
    assert re.search(r"Certificate, by other code: true( \([^)]*\))?; distance ", page.one(".proof").text)
    page.hover("h1")
    assert page.all(".object.witness") == []


def test_a_false_condition_shows_its_nearest_rival_and_margin(page: Page, made: Run) -> None:
    name, k = relational(made, False)
    row = made.manifest[name]
    condition = row["program"]["conditions"][k]
    page.go(f"#/episode/{name}")
    page.one(f".tree [data-condition='{k}']").click()
    rivals = objects(page, "rival")
    assert rivals
    anchor = condition["qualifier"]["anchors"][0]["object_id"]
    predicate = condition["qualifier"]["predicate"]
    quantity = "used_distance" if predicate == "far from" else "greatest(0, 0)"
    decided = [line.split("|") for line in cells(page, "facts") if "decides" in line]
    assert len(decided) == len(rivals)
    margins = [float(line[-1].removesuffix(" m")) for line in decided]
    assert margins == sorted(margins), "the nearest to being a witness comes first"
    verdict = page.one(".verdict").text
    assert verdict.startswith("✘ False: ")
    assert f"so it is false, by {margins[0]:.2f} m" in verdict
    sql = f"""select subject, greatest(a.aabb_min.x - b.aabb_max.x, b.aabb_min.x - a.aabb_max.x, 0) as x,
        greatest(a.aabb_min.z - b.aabb_max.z, b.aabb_min.z - a.aabb_max.z, 0) as z, {quantity} from relations
        join objects a on a.object_id = subject and a.scene_id = relations.scene_id and a.source = relations.source
        join objects b on b.object_id = target and b.scene_id = relations.scene_id and b.source = relations.source
        where relations.kind = 'canonical' and relations.scene_id = '{row["scene_id"]}' and target = '{anchor}'
        and relations.source = '{row["source"]}' and list_contains({rivals}, subject)"""
    for _, x, z, used in made.ask(sql):
        value = used if predicate == "far from" else math.hypot(x, z)
        assert any(line[-3] == f"{value:.2f} m" for line in decided), (value, decided)


def test_text_tree_and_plan_are_linked(page: Page, made: Run) -> None:
    name, row = min(made.manifest.items())
    page.go(f"#/episode/{name}")
    for k in range(len(row["program"]["conditions"])):
        assert page.all(f".instruction [data-condition='{k}']"), f"condition {k} has no clause"
    for leaf in row["leaves"]:
        page.hover(f".instruction [data-leaf='{leaf['leaf']}']")
        assert page.texts(f".tree .lit[data-leaf='{leaf['leaf']}']")
        assert page.all(".way.lit")
        assert leaf["object_id"] in objects(page, "goal")
    page.one(".tree [data-condition='0']").send_keys("\ue007")
    page.hover("h1")
    assert page.one(".tree [data-condition='0']").get_attribute("aria-pressed") == "true"
    facts = dict(zip(page.texts(".facts-list dt"), page.texts(".facts-list dd"), strict=True))
    assert facts["split"] == row["split"]
    assert facts["step budget"] == f"{row['max_steps']} steps"
    assert facts["by all stops"] == f"{row['route_length']:.2f} m"
    assert facts["certificate"].startswith("proven, ")


def test_a_marked_condition_is_part_of_the_address(page: Page, made: Run) -> None:
    name, k = relational(made, False)
    page.go(f"#/episode/{name}")
    page.one(f".tree [data-condition='{k}']").click()
    address = page.run("return location.hash")
    assert address.endswith(f"mark={'ABCDEFGH'[k]}")
    page.open(address)
    assert page.one(f".tree [data-condition='{k}']").get_attribute("aria-pressed") == "true"
    assert page.one(".verdict").text.startswith("✘ False")
    page.one(f".tree [data-condition='{k}']").click()
    assert "mark" not in page.run("return location.hash")


def test_the_plan_is_to_scale(page: Page, made: Run) -> None:
    name, row = min(made.manifest.items())
    page.go(f"#/episode/{name}")
    gold = next(leaf for leaf in row["leaves"] if leaf["leaf"] == row["gold_leaf"])
    points = [tuple(map(float, p.split(","))) for p in str(page.one(".way.gold").get_attribute("points")).split()]
    circle = page.one(".arrow.start circle")
    start = [float(circle.get_attribute(name) or "nan") for name in ("cx", "cy")]
    assert points[0] == pytest.approx(start, abs=0.1)
    path = gold["reference_path"]
    far = max(range(len(path)), key=lambda k: abs(path[k][0] - path[0][0]) + abs(path[k][2] - path[0][2]))
    metres = ((path[far][0] - path[0][0]) ** 2 + (path[far][2] - path[0][2]) ** 2) ** 0.5
    pixels = ((points[far][0] - points[0][0]) ** 2 + (points[far][1] - points[0][1]) ** 2) ** 0.5
    room, corners = made.ask(f"""select room_id, polygon from rooms where polygon is not null
        and scene_id = '{row["scene_id"]}' and source = '{row["source"]}' order by 1""")[0]
    east = [corner["x"] for corner in corners]
    box = page.run("return document.querySelector(`[data-room='${arguments[0]}']`).getBBox().width", room)
    assert box / (max(east) - min(east)) == pytest.approx(pixels / metres, rel=0.02)
    page.one("input.navmesh").click()
    assert not page.one(".layer-floor").is_displayed()


def test_playback_walks_to_the_goal(page: Page, made: Run) -> None:
    name = min(key for key, row in made.manifest.items() if row["split"] == made.split)
    page.go(f"#/episode/{name}")
    step = """const slider = document.querySelector('.playback input[type=range]');
        slider.value = arguments[0] ?? slider.max; slider.dispatchEvent(new Event('input'))"""
    drawn = "return document.querySelector('.layer-walk .walk').getAttribute('points').split(' ').length"
    before = cells(page, "walks")
    assert before[0].endswith(f"|success leaf {made.manifest[name]['gold_leaf']}"), "whole walks come first"
    assert float(before[0].split("|")[2]) < made.manifest[name]["success_distance"]
    whole = page.run(drawn)
    page.run(step, 0)
    start = cells(page, "walks")
    assert start[0].startswith("perfect|0 of ")
    assert float(start[0].split("|")[2]) == pytest.approx(made.manifest[name]["geodesic_distance"], abs=0.02)
    assert page.run(drawn) == 1, "what comes later is not drawn"
    page.one(".play").click()
    page.until("return Number(document.querySelector('.playback input[type=range]').value) > 2")
    page.one(".play").click()
    assert 1 < page.run(drawn) < whole
    page.run(step)
    assert cells(page, "walks") == before
    page.one("[data-agent='always-then']").click()
    assert len(cells(page, "walks")) == 3


def test_keys_and_links_lead_through_a_list(page: Page, made: Run) -> None:
    page.open("#/browse?category=nested")
    listed = page.texts(".episodes .id")
    page.one(".episodes a").click()
    page.one("#next")
    assert page.texts("#place") == [f"1 of {len(listed)}"]
    for key in ("ARROW_RIGHT", "n", "ARROW_LEFT"):
        before = page.run("return location.hash")
        page.key(key)
        shown = "document.title.includes(location.hash.split('/')[2].split('?')[0])"
        page.until(f"return location.hash !== arguments[0] && {shown}", before)
    assert listed[1] in page.run("return location.hash")
    page.open(page.run("return location.hash"))  # the address alone leads to the same place
    assert page.texts("#place") == [f"2 of {len(listed)}"]
    page.key("ESCAPE")
    page.until("return location.hash.startsWith('#/browse')")
    assert page.texts(".episodes .id") == listed


def test_a_group_is_shown_side_by_side(page: Page, made: Run) -> None:
    groups = "select group_id, count(*) from episodes where group_id is not null group by 1 order by 1"
    group, wanted = made.ask(groups)[0]
    name = made.ask(f"select min(episode_id) from episodes where group_id = '{group}'")[0][0]
    page.go(f"#/episode/{name}")
    page.one("#group").click()
    page.until("return document.querySelectorAll('.side-by-side .plan').length > 0")
    assert len(page.all(".side-by-side section")) == wanted
    assert all(text.startswith("Changed: ") for text in page.texts(".changed")[1:])
    numbers = """return [...document.querySelectorAll('.side-by-side section')].map((one) => Object.fromEntries(
        [...one.querySelectorAll('.mark.goal, .mark.star')].map((mark) =>
            [mark.querySelector('title').textContent.split(': ')[1],
            [mark.querySelector('text').textContent, getComputedStyle(mark).fill]])))"""
    first, *others = page.run(numbers)
    assert all(own == first for own in others), "a goal keeps its number and its colour"


def test_an_object_shows_its_relations(page: Page, made: Run) -> None:
    source, scene, subject, n = made.ask("""select source, scene_id, subject, count(distinct target) n from relations
        where kind = 'canonical' group by all order by n desc, 1, 2, 3""")[0]
    page.go(f"#/scene/{source}%2F{scene.replace('/', '%2F')}?object={subject}")
    rows = cells(page, "edges")
    assert len(rows) == n
    used = made.ask(f"""select target, used_distance, horizontal_distance, -delta.y from relations where kind =
        'canonical'
        and source = '{source}' and scene_id = '{scene}' and subject = '{subject}'""")
    # the first cell is "label (id)"; ids have bars, so numbers are counted from the end
    cut = [row.rsplit("|", 6) for row in rows]
    shown = {row[0].rsplit(" (", 1)[1].rstrip(")"): [float(row[k]) for k in (2, 4, 5)] for row in cut}
    assert shown.keys() == {target for target, *_ in used}
    assert all(shown[target] == pytest.approx(own, abs=0.006) for target, *own in used)  # two decimals are shown
    said = {row[0].rsplit(" (", 1)[1].rstrip(")"): row[6] for row in cut}
    margins = made.ask(f"""select target, predicate, margin, true_in_text from relations where kind = 'semantic'
        and source = '{source}' and scene_id = '{scene}' and subject = '{subject}'""")
    for target, predicate, margin, fit in margins:
        assert f"{'✔ ' if fit else ''}{predicate}{'' if margin is None else f' {margin:.2f}'}" in said[target]
    asked = f"from visibility where source = '{source}' and scene_id = '{scene}' and object_id = '{subject}'"
    share, seen_from, places = made.ask(f"select share, from_places, places {asked}")[0]
    facts = dict(zip(page.texts("#object dt"), page.texts("#object dd"), strict=True))
    assert f"{100 * share:.0f} % of its surface, from {seen_from} of {places} places" in facts["seen"].replace(",", ",")
    on = f"select object_id from objects where source = '{source}' and scene_id = '{scene}' and support = '{subject}'"
    assert [name for (name,) in made.ask(on)] == [
        node.rsplit("(", 1)[1].rstrip(")") for node in page.texts("#object dd:last-child button")
    ]
    near = made.ask(f"""select target from relations where predicate = 'near' and source = '{source}'
        and scene_id = '{scene}' and subject = '{subject}' and kind = 'semantic' order by 1""")
    assert objects(page, "witness") == [target for (target,) in near]
    other = page.all("[data-table='edges'] button")[0]
    name = other.text
    other.click()
    assert page.one("#object h2").text == name
    shapes = [node for node in page.all(".object") if node.get_attribute("data-object") == subject]
    page.run("arguments[0].dispatchEvent(new MouseEvent('click', {bubbles: true}))", shapes[0])
    assert f"({subject})" in page.one("#object h2").text


def test_labels_do_not_overlap_and_the_page_fits(page: Page, made: Run) -> None:
    script = """const boxes = [...document.querySelectorAll('.layer-labels .object-label, .layer-labels .room-label')]
        .map((node) => [node.textContent, node.getBoundingClientRect()]);
        const bad = [];
        for (const [a, p] of boxes) for (const [b, q] of boxes) {
            if (p === q) continue;
            const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
            const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
            if (wide > 3 && high > 5) bad.push(`${a} and ${b}: ${wide} x ${high}`);
        }
        return [boxes.length, bad]"""
    for width in (1280, 390):
        page.size(width)
        for name in sorted(made.manifest)[:3]:
            page.open(f"#/episode/{name}")
            labels, bad = page.run(script)
            assert labels > 0
            assert bad == [], width
        for address in (
            "#/browse",
            f"#/episode/{min(made.manifest)}",
            "#/statistics",
            "#/agents",
            "#/scenes",
            "#/help",
        ):
            page.open(address)
            assert page.run("return document.documentElement.scrollWidth <= arguments[0]", width), (width, address)


def test_a_broken_address_says_so(page: Page) -> None:
    for address in ("#/episode/0", "#/scene/no%2Fwhere", "#/group/77777", "#/constructor", "#/views"):
        page.open(address)
        assert "there is no" in page.one("[role=alert]").text


def test_all_categories_print(page: Page, made: Run, tmp_path: Path) -> None:
    page.go(f"#/episode/{min(made.manifest)}")
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert not page.driver.find_element(By.CSS_SELECTOR, "header nav").is_displayed()
    assert page.driver.find_element(By.CSS_SELECTOR, ".plan").is_displayed()
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
