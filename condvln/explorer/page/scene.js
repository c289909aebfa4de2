"use strict";
/* The list of scenes, and the view of one: its plan, its objects, and the relations of a chosen object. */

{
  const { element, link, number, count } = explorer;

  /* Return by scene the episodes on which an agent was scored, and those of them that it did not finish. */
  function byScene(agent) {
    const { index } = explorer;
    const found = index.scenes.map(() => [0, 0]);
    for (let row = 0; row < index.size; row += 1) {
      if (!agent.outcome[row]) continue;
      found[index.columns.scene[row]][0] += 1;
      found[index.columns.scene[row]][1] += agent.outcome[row] > 1;
    }
    return found;
  }

  /* Return an agent's success rate in a scene, linked to the episodes that it failed. */
  function rate(agent, [scored, failed], scene) {
    if (!scored) return "–";
    const text = `${number(100 * (1 - failed / scored), 0)} %`;
    return failed ? link(text, "browse", { scene, [`agent:${agent.name}`]: explorer.filters.NOT_SUCCESS }, { title: `${failed} of ${scored} failed` }) : text;
  }

  explorer.views.scenes = async (main) => {
    const { index } = explorer;
    const known = index.scenes.some((scene) => scene.wanted !== undefined);
    const results = index.agents.map(byScene);
    const rows = index.scenes.map((scene, k) => {
      const name = `${scene.source}/${scene.id}`;
      const made = known ? [count(scene.wanted ?? 0), count(scene.placed ?? 0), (scene.reason || "–").replaceAll("_", " ")] : [];
      return [link(name, `scene/${encodeURIComponent(name)}`), known ? count(scene.rooms) : "–", known ? count(scene.objects) : "–", ...made,
        scene.episodes ? link(count(scene.episodes), "browse", { scene: name }) : "0", ...index.agents.map((agent, n) => rate(agent, results[n][k], name))];
    });
    const heads = ["scene", "#rooms", "#objects", ...(known ? ["#wanted", "#placed", "main reason for less"] : []), "#episodes", ...index.agents.map((agent) => `#SR of ${agent.name}`)];
    main.replaceChildren(element("h1", {}, "Scenes"),
      element("p", { class: "note" }, `Choose a heading to sort. ${known ? "A scene's page says why it has fewer episodes than wanted" : "This page was made of an export alone: condvln explore CONFIG adds rooms, objects, and why a scene yields little"}; a success rate leads to the episodes that failed.`),
      element("div", { class: "stacked sorted" }, explorer.sortable(explorer.table("Scenes", heads, rows, "scenes"))));
    return "Scenes";
  };

  const MOST = 3;

  /* Return why a scene has fewer episodes than wanted: a row for each cell, what explains it best first. */
  function yields(made, entry, name) {
    if (!made) return "";
    const rows = made.funnel.map(([cell, wanted, candidates, , placed]) => {
      const own = made.rejections.filter((row) => row[0] === cell).slice(0, placed < wanted ? MOST : 0);
      const asked = { scene: name, [cell === "counterfactual groups" ? "group" : "category"]: cell === "counterfactual groups" ? "any" : cell };
      return [link(cell.replaceAll("_", " "), "browse", asked), count(wanted), count(candidates), count(placed),
        own.length ? element("ul", { class: "plain" }, own.map(([, stage, reason, n, rule]) => element("li", {}, `${count(n)} ${stage === "episodes" ? "candidates" : "draws"}: ${rule || reason}`))) : "–"];
    });
    const short = made.funnel.filter((row) => row[4] < row[1]).length;
    return element("section", { class: "stacked wide yields", id: "yield" }, element("h2", {}, "What it yields"),
      element("p", {}, short ? `${count(entry.placed)} of ${count(entry.wanted)} wanted episodes were placed. Main reason: ${(entry.reason || "no candidate could be drawn").replaceAll("_", " ")}.` : `All ${count(entry.wanted)} wanted episodes were placed.`),
      explorer.table("Candidates and episodes by category, and what rejected most", ["category", "#wanted", "#candidates", "#placed", "rejected because"], rows, "yield"));
  }

  function agentsHere(at, name) {
    const { agents } = explorer.index;
    const scored = agents.map((agent) => [agent, byScene(agent)[at]]).filter(([, found]) => found[0]);
    return scored.length ? element("p", { id: "agents-here" }, "Success here: ", scored.map(([agent, found], k) => [k ? ", " : "", `${agent.name} `, rate(agent, found, name)])) : "";
  }

  function describe(item, scene, pick) {
    const room = scene.rooms[item.room];
    const height = item.low === null ? "unknown" : `${number(item.low)} to ${number(item.high)} m`;
    const looked = item.places ? `: ${number(item.share * 100, 0)} % of its surface, from ${item.from_places} of ${item.places} places in the room`
      + `${item.nearest_view === null ? "" : `, the nearest ${number(item.nearest_view)} m away`}` : "";
    const seen = (item.hidden ? "hidden in something shut" : item.seeable === true ? "seeable" : item.seeable === false ? "not seeable enough for text" : "unknown") + (item.hidden ? "" : looked);
    const known = (id) => scene.objects.findIndex((one) => one.id === id);
    const those = (name) => scene.objects.filter((one) => one[name] === item.id).map((one) => one.id);
    const listed = (ids) => (ids.length ? element("ul", { class: "plain" }, ids.map((id) => element("li", {}, known(id) < 0 ? id : element("button", { type: "button", class: "as-link", onclick: () => pick(known(id)) }, explorer.thing(scene, id))))) : "–");
    const fact = (name, value) => [element("dt", {}, name), element("dd", { "data-fact": name }, value)];
    return element("dl", { class: "facts-list" }, fact("label", item.label), fact("the source's label", item.raw), fact("room", room ? room.label : "–"),
      fact("geometry", item.geometry), fact("height", height), fact("seen", seen), fact("it is in", listed(item.parent ? [item.parent] : [])), fact("it is on", listed(item.support ? [item.support] : [])),
      fact("in it", listed(those("parent"))), fact("on it", listed(those("support"))));
  }

  /* Return the edges of an object to all others as rows: other, distance, direction, predicates with margins. */
  function edges(graph, scene, chosen) {
    const others = new Map();
    for (let k = 0; k < graph.subject.length; k += 1) {
      if (graph.subject[k] !== chosen) continue;
      const other = graph.target[k];
      const own = others.get(other) || { other, semantic: [] };
      if (graph.semantic[k]) own.semantic.push({ predicate: graph.predicates[graph.predicate[k]], inText: graph.in_text[k], margin: graph.margin[k] });
      else Object.assign(own, { direction: graph.predicates[graph.predicate[k]], used: graph.used_distance[k], horizontal: graph.horizontal_distance[k],
        height: graph.height[k], surface: graph.surface_distance[k] });
      others.set(other, own);
    }
    return [...others.values()].sort((a, b) => (a.used ?? 99) - (b.used ?? 99));
  }

  function relationTable(found, scene, item, pick) {
    const said = (one) => element("ul", { class: "predicates" }, one.semantic.map((edge) => element("li", { class: edge.inText ? "fit" : "unfit" },
      `${edge.inText ? "✔ " : ""}${edge.predicate}${edge.margin === null ? "" : ` ${number(edge.margin)}`}`)));
    const rows = found.map((one) => [
      element("button", { type: "button", class: "as-link", onclick: () => pick(one.other) }, explorer.thing(scene, scene.objects[one.other].id)), one.direction || "–",
      number(one.used), number(one.surface), number(one.horizontal), number(one.height), one.semantic.length ? said(one) : "–"]);
    return element("section", { class: "relations" }, explorer.table(`Relations of the ${item.label} (${item.id}) to the other objects of its room`,
      ["to", "it lies", "#distance, m", "#surfaces, m", "#on the ground, m", "#higher, m", "predicates"], rows, "edges"),
      element("p", { class: "note" }, "Distances: between the boxes, between the surfaces, between the centres on the ground; and how much higher the chosen object is. "
        + "✔: text may say so. The number after a predicate is its margin in widths of the dead zone; text needs at least 1, and the predicate's other rules."));
  }

  explorer.views.scene = async (main, path, asked) => {
    const name = decodeURIComponent(path[0]);
    const at = explorer.index.scenes.findIndex((scene) => `${scene.source}/${scene.id}` === name);
    if (at < 0) throw new Error(`there is no scene ${name}`);
    const entry = explorer.index.scenes[at];
    const scene = await explorer.load(`scene-${at}`);
    const graph = entry.graph ? await explorer.load(`graph-${at}`) : null;
    const holder = element("div", { class: "plan-holder" });
    const details = element("div", { class: "details", id: "object" }, element("p", {}, "Choose an object on the plan or in the list."));
    const list = element("select", { id: "objects", size: 8, "aria-label": "Objects" }, scene.rooms.length
      ? scene.rooms.map((room, k) => element("optgroup", { label: explorer.shown(`${room.label} (${room.id})`) },
        scene.objects.map((item, n) => (item.room === k ? element("option", { value: n }, `${item.label} (${item.id})${item.hidden ? " hidden" : ""}`) : null))))
      : scene.objects.map((item, n) => element("option", { value: n }, item.id)));
    const relations = element("div", { class: "wide", id: "relations" });
    let plan = null;
    let chosen = -1;

    function pick(number_) {
      chosen = number_;
      const item = scene.objects[chosen];
      list.value = String(chosen);
      history.replaceState(null, "", explorer.address(`scene/${encodeURIComponent(name)}`, { object: item.id }));
      const found = graph ? edges(graph, scene, chosen) : [];
      details.replaceChildren(element("h2", {}, `${item.label} (${item.id})`), describe(item, scene, pick));
      relations.replaceChildren(graph ? relationTable(found, scene, item, pick)
        : element("p", {}, "Relations are known only where a configuration is explored."));
      light(found);
      explorer.say(`${item.label}, ${found.length} relations`);
    }

    function light(found) {
      if (chosen < 0 || !plan) return;
      const item = scene.objects[chosen];
      const id = (number_) => scene.objects[number_].id;
      const holds = (one, ...predicates) => one.semantic.some((edge) => predicates.includes(edge.predicate));
      plan.light("chosen", [item.id]);
      plan.name([item.id]);
      plan.light("witness", found.filter((one) => holds(one, "near")).map((one) => id(one.other)));
      const resting = scene.objects.filter((one) => one.support === item.id || one.parent === item.id || one.id === item.support || one.id === item.parent);
      plan.light("anchor", resting.map((one) => one.id));
      plan.clear("rays");
      for (const one of found.filter((edge) => holds(edge, "near"))) plan.way("rays", [item.center, scene.objects[one.other].center], "measure");
    }

    /* Objects that a link names, such as those of a rejected candidate. */
    const marked = (asked.mark || "").split("\n").filter(Boolean);
    const options = { title: `Plan of scene ${name}, north up`, named: marked, pick: (item, k) => pick(k), level: null };
    const draw = () => {
      plan = new explorer.Plan(holder, scene, options);
      if (chosen >= 0) light(graph ? edges(graph, scene, chosen) : []);
      else if (marked.length) {
        plan.light("goal", marked);
        plan.name(marked);
      }
    };
    list.addEventListener("change", () => pick(Number(list.value)));
    const navmesh = element("input", { type: "checkbox", checked: true, onchange: () => {
      options.navmesh = navmesh.checked;
      plan.layers.floor.classList.toggle("off", !navmesh.checked);
    } });
    const levels = explorer.levels(scene);
    const storey = levels.length > 1 ? element("select", { "aria-label": "Storey", onchange: (event) => {
      options.level = event.target.value === "" ? null : Number(event.target.value);
      draw();
    } }, element("option", { value: "" }, "all storeys"), levels.map((level) => element("option", { value: level }, `storey ${level}`))) : null;
    main.replaceChildren(element("h1", {}, `Scene ${name}`),
      element("p", {}, `${count(entry.rooms)} ${entry.rooms === 1 ? "room" : "rooms"}, ${count(entry.objects)} objects, `, link(`${count(entry.episodes)} episodes`, "browse", { scene: name })), agentsHere(at, name),
      element("div", { class: "episode" }, element("div", { class: "left" }, holder, element("div", { class: "row switches" }, element("label", {}, navmesh, " navmesh"), explorer.zoom(holder, options, () => plan, draw), storey),
        element("ul", { class: "legend" }, [["chosen", "chosen"], ["witness", "near it"], ["anchor", "in or on it, or it is in or on that"], ["hidden", "hidden in something shut"], ["unseen-key", "not seeable enough for text"]].map(([kind, text]) =>
          element("li", {}, element("span", { class: `key ${kind}` }), text)))),
      element("div", { class: "right" }, element("label", { for: "objects" }, "Objects by room"), list, details), yields(scene.made, entry, name), relations));
    draw();
    new ResizeObserver(explorer.later(() => { if (holder.isConnected && Math.abs(holder.clientWidth - plan.width) > 2) draw(); }, 120)).observe(holder);
    const wanted = scene.objects.findIndex((item) => item.id === asked.object);
    if (wanted >= 0) pick(wanted);
    return `Scene ${name}`;
  };
}
