"use strict";
/* The list of episodes with its filters. The filter is the address, so that every list has a link. */

{
  const { element, number } = explorer;
  const TITLES = {
    split: "Split", source: "Source", category: "Category", composition: "Composition", observability: "Observability",
    gold_label: "Gold goal", label: "Names", predicate: "Asks", depth: "Depth", chain: "Chain", moves: "Moves",
    words: "Words", route_length: "Route, m", geodesic_distance: "Direct, m", scene: "Scene", group: "Group", q: "Text",
    differ: "Agents", untrue: "Conditions", pictures: "Pictures",
  };

  function select(name, values, asked, change) {
    const node = element("select", { id: `filter-${name}`, name }, element("option", { value: "" }, "all"),
      values.map((value) => element("option", { value, selected: asked[name] === String(value) }, explorer.meaning(value) ? `${value}: ${explorer.meaning(value)}` : value)));
    node.addEventListener("change", () => change(name, node.value));
    return field(name, node);
  }

  /* Return a choice between all and a few named values. */
  function pick(name, values, asked, change, title) {
    const node = element("select", { id: `filter-${name}`, name }, element("option", { value: "" }, "all"),
      values.map(([value, label]) => element("option", { value, selected: asked[name] === value }, label)));
    node.addEventListener("change", () => change(name, node.value));
    return field(name, node, title);
  }

  function field(name, node, title) {
    return element("div", { class: "field" }, element("label", { for: `filter-${name}` }, title || TITLES[name]), node);
  }

  function typedField(name, asked, change, hints, type = "text") {
    const node = element("input", { id: `filter-${name}`, name, type, value: asked[name] || "", autocomplete: "off",
      list: hints ? `list-${name}` : null, placeholder: explorer.filters.RANGES.includes(name) ? "from..to" : null });
    node.addEventListener(hints ? "change" : "input", explorer.later(() => change(name, node.value.trim()), hints ? 0 : 200));
    const all = hints && element("datalist", { id: `list-${name}` }, hints.map((hint) => element("option", { value: hint })));
    return field(name, all ? element("span", {}, node, all) : node);
  }

  /* Return the form of filters; `change(name, value)` is called with each change. */
  function form(asked, change) {
    const { index } = explorer;
    const { CHOICES, RANGES } = explorer.filters;
    const sorted = (names) => [...names].sort();
    const search = typedField("q", asked, change, null, "search");
    search.classList.add("wide");
    const scenes = index.scenes.map((scene) => `${scene.source}/${scene.id}`);
    const groups = element("select", { id: "filter-group", name: "group" }, element("option", { value: "" }, "all"),
      element("option", { value: "any", selected: asked.group === "any" }, "in a group"),
      asked.group && asked.group !== "any" ? element("option", { value: asked.group, selected: true }, `group ${asked.group}`) : null);
    groups.addEventListener("change", () => change("group", groups.value));
    const agents = index.agents.map((agent) => {
      const [first, success, ...failures] = index.outcomes;
      return pick(`agent:${agent.name}`, [explorer.filters.SCORED, success, explorer.filters.NOT_SUCCESS, ...failures, first].map((one) => [one, one]), asked, change, `Agent ${agent.name}`);
    });
    if (agents.length > 1) agents.push(pick("differ", [["outcome", "they differ"]], asked, change));
    agents.push(pick("untrue", [["some", "one is false"], ["none", "all are true"]], asked, change));
    if (index.columns.pictures.some((value) => value > 0)) agents.push(pick("pictures", [["some", "with pictures"]], asked, change));
    return element("form", { class: "filters", "aria-label": "Filters", onsubmit: (event) => event.preventDefault() }, search,
      CHOICES.filter((name) => name !== "gold_label").map((name) => select(name, sorted(index.names[name]), asked, change)),
      typedField("scene", asked, change, scenes),
      typedField("label", asked, change, sorted(index.names.label)),
      typedField("gold_label", asked, change, sorted(index.names.label)),
      select("predicate", sorted(index.names.predicate), asked, change),
      RANGES.map((name) => typedField(name, asked, change)), field("group", groups), agents,
      element("div", { class: "field" }, element("a", { href: "#/browse", id: "clear" }, "Clear all filters")));
  }

  function entry(row, asked, slot) {
    const { index } = explorer;
    const id = index.columns.id[row];
    const at = (name) => explorer.named(name, row);
    const scene = index.scenes[index.columns.scene[row]];
    const outcomes = index.agents.filter((agent) => agent.outcome[row]).map((agent) =>
      element("a", { class: `outcome outcome-${agent.outcome[row]}`, href: explorer.address(`episode/${id}`, { ...asked, walk: agent.name }), title: `The episode with the walk of ${agent.name}` },
        `${agent.name}: ${index.outcomes[agent.outcome[row]]}`));
    return element("li", {},
      element("a", { href: explorer.address(`episode/${id}`, asked), "data-episode": id },
        element("span", { class: "id" }, id), " ", element("span", { class: "tags" },
          `${at("split")} · ${scene.source}/${scene.id} · `, explorer.code(at("category")), " · ", explorer.code(at("composition")), " · ", explorer.code(at("observability")),
          ` · ${number(index.columns.route_length[row], 1)} m · gold: ${at("gold_label")}`)),
      slot, outcomes.length ? element("p", { class: "outcomes" }, outcomes) : null);
  }

  /* Show the episodes of one page of the list. */
  async function list(holder, found, asked) {
    const pages = Math.max(1, Math.ceil(found.length / explorer.PAGE));
    const page = Math.min(pages, Math.max(1, Number(asked.page) || 1));
    const rows = [...found.slice((page - 1) * explorer.PAGE, page * explorer.PAGE)];
    const kept = { ...asked, page: "" };
    const slots = rows.map(() => element("p", { class: "text", dir: "auto" }, "…"));
    const turner = (first) => (pages > 1 ? [` · page ${page} of ${explorer.count(pages)} `, turn("← previous page", page - 1, first && "page-before"), " ", turn("next page →", page + 1, first && "page-after")] : "");
    const turn = (label, to, id) => to >= 1 && to <= pages && to !== page
      ? explorer.link(label, "browse", { ...kept, page: to === 1 ? "" : String(to) }, { id }) : null;
    holder.replaceChildren(
      element("p", { id: "count", "data-count": found.length }, `${explorer.count(found.length)} of ${explorer.count(explorer.index.size)} episodes`,
        turner(true)),
      element("ol", { class: "episodes", start: (page - 1) * explorer.PAGE + 1 }, rows.map((row, k) => entry(row, kept, slots[k]))), pages > 1 ? element("p", {}, turner(false)) : "");
    await Promise.all(rows.map(async (row, k) => { slots[k].textContent = explorer.shown(await explorer.loadText(row)); }));
  }

  explorer.views.browse = async (main, path, asked) => {
    let now = { ...asked };
    const results = element("div", { id: "results" });
    async function change(name, value) {
      now = { ...now, [name]: value, page: "" };
      for (const key of Object.keys(now)) if (!now[key]) delete now[key];
      history.replaceState(null, "", explorer.address("browse", now));
      const before = now;
      const found = await explorer.filter(now);
      if (before !== now) return;  // a later change is under way
      await list(results, found, now);
      explorer.say(`${found.length} episodes`);
    }
    const wide = matchMedia("(min-width: 700px)").matches;
    const active = Object.keys(now).filter((name) => name !== "page").length;
    main.replaceChildren(element("h1", {}, explorer.index.title),
      element("details", { class: "filter-box", open: wide || active > 0 }, element("summary", {}, "Filters"), form(now, change)), results);
    await list(results, await explorer.filter(now), now);
    return "Episodes";
  };

  explorer.TITLES = TITLES;
}
