"use strict";
/* The view of one episode: plan, instruction, tree, evidence, axes, certificate, pictures, and agents' walks. */

{
  const { element, number, link } = explorer;
  const meaning = (code) => (explorer.meaning(code) ? `${code}, ${explorer.meaning(code)}` : code || "unknown");

  /* Number and colour of a leaf: its own number, or within a group those of the same goal in the first episode. */
  const tag = (leaf) => leaf.tag ?? leaf.leaf;
  function kindOf(episode, leaf) {
    if (leaf.tag !== undefined) return `leaf-${leaf.tag % 4}${leaf.leaf === episode.gold ? " taken" : ""}`;
    return leaf.leaf === episode.gold ? "gold" : `leaf-${leaf.leaf % 4}`;
  }

  /* Draw an episode over a plan. Returns `choose(about)`, which marks a condition or a leaf, or nothing. */
  function drawing(episode) {
    const leaves = new Map();
    let plan = null;
    let fixed = null;
    let shown = null;  // what is pointed at or chosen, also before the plan is drawn

    function over(drawn) {
      plan = drawn;
      leaves.clear();
      const order = episode.leaves.filter((leaf) => leaf.leaf !== episode.gold);
      const gold = episode.leaves.find((leaf) => leaf.leaf === episode.gold);
      for (const leaf of [...order, gold]) {
        const kind = kindOf(episode, leaf);
        const nodes = [plan.way("paths", leaf.path, kind)];
        for (const [k, stop] of leaf.stops.entries()) {
          nodes.push(plan.mark(stop.at, `stop ${kind}`, String.fromCharCode(97 + k), `leaf ${leaf.leaf}, stop ${k + 1}: ${explorer.thing(plan.scene, stop.object)}`));
        }
        for (const goal of leaf.goals.slice(1)) nodes.push(plan.mark(goal, `dot ${kind}`, "", `leaf ${leaf.leaf}: another goal point`));
        const end = leaf.path[leaf.path.length - 1];
        nodes.push(plan.mark(end, `${leaf === gold ? "star" : "goal"} ${kind}`, String(tag(leaf)), `leaf ${tag(leaf)}: ${explorer.thing(plan.scene, leaf.object)}`));
        leaves.set(leaf.leaf, nodes);
      }
      if (episode.looking) plan.way("paths", episode.looking.path, "looking");
      const eyes = new Map();  // conditions that are decided at one place share an eye
      for (const [k, view] of Object.entries(episode.views || {})) eyes.set(String(view.at), [...(eyes.get(String(view.at)) || []), [explorer.letter(Number(k)), view]]);
      for (const own of eyes.values()) {
        plan.mark(own[0][1].at, "eye", own.map(([letter]) => letter).join(" "), own.map(([letter, view]) =>
          `${letter} is decided here: after ${view.frame} actions, ${number(view.walked, 1)} m along the looking path`).join("; "));
      }
      plan.arrow("marks", episode.start, episode.heading, "start");
      mark(shown);
    }

    function mark(about) {
      if (!plan) return;
      plan.clear("rays");
      plan.name([]);
      for (const kind of ["witness", "rival", "anchor", "goal"]) plan.light(kind, []);
      for (const nodes of leaves.values()) for (const node of nodes) node.classList.remove("lit", "dim");
      if (about?.leaf !== undefined) {
        const leaf = episode.leaves.find((one) => one.leaf === about.leaf);
        for (const [name, nodes] of leaves) for (const node of nodes) node.classList.add(name === about.leaf ? "lit" : "dim");
        plan.light("goal", [leaf.object, ...leaf.stops.map((stop) => stop.object)]);
        plan.name([leaf.object, ...leaf.stops.map((stop) => stop.object)]);
      }
      if (about?.condition !== undefined) markCondition(about.condition);
    }

    function markCondition(index) {
      const condition = episode.program.conditions[index];
      const things = episode.facts?.[index].things || condition.witnesses.map((id) => ({ id, role: "witness" }));
      const anchors = condition.qualifier ? condition.qualifier.anchors.map((anchor) => anchor.object_id) : [];
      plan.light("witness", things.filter((thing) => thing.role === "witness").map((thing) => thing.id));
      plan.light("rival", things.filter((thing) => thing.role !== "witness").map((thing) => thing.id));
      plan.light("anchor", anchors);
      plan.name([...things.map((thing) => thing.id), ...anchors]);
      const centre = (id) => plan.scene.objects.find((item) => item.id === id)?.center;
      const targets = things.map((thing) => centre(thing.id)).filter(Boolean);
      for (const anchor of anchors.map(centre).filter(Boolean)) {
        for (const target of targets) plan.way("rays", [anchor, target], "measure");
      }
      const view = episode.views?.[index];
      if (view) {
        for (const target of [...targets, ...anchors.map(centre).filter(Boolean)]) plan.way("rays", [view.at, target], "ray");
        plan.layers.named.append(explorer.svg("text", { x: plan.x(view.at[0]), y: plan.y(view.at[2]) - 14, class: "eye-label", "font-size": 11 }, `after ${view.frame} actions`));
      }
    }

    function choose(about, keep) {
      if (keep) fixed = JSON.stringify(about) === JSON.stringify(fixed) ? null : about;
      shown = about || fixed;
      mark(shown);
      return fixed;
    }

    return { over, choose };
  }

  function positions(episode) {
    return [episode.start, ...episode.leaves.flatMap((leaf) => [...leaf.path, ...leaf.goals]), ...(episode.looking?.path || [])];
  }

  /* Return a plan with its switches. `drawn` is what `drawing` returned. */
  function planPanel(scene, episode, drawn, onDraw) {
    const holder = element("div", { class: "plan-holder" });
    const named = [...new Set([...episode.leaves.flatMap((leaf) => [leaf.object, ...leaf.stops.map((stop) => stop.object)]),
      ...episode.program.conditions.flatMap((one) => [...one.witnesses, ...(one.qualifier?.anchors || []).map((a) => a.object_id)])])];
    const options = {
      title: `Plan of scene ${episode.scene}, north up, with the start and the ways to all leaves`,
      points: positions(episode), named, level: null,
      height: onDraw ? Math.max(340, Math.min(window.innerHeight * 0.66, 720)) : null, over: (plan) => { drawn.over(plan); if (onDraw) onDraw(plan); },
      pick: (item) => { location.hash = explorer.address(`scene/${encodeURIComponent(`${episode.source}/${episode.scene}`)}`, { object: item.id }); },
    };
    let plan = null;
    const draw = () => { plan = new explorer.Plan(holder, scene, options); };
    const navmesh = element("input", { type: "checkbox", checked: true, class: "navmesh", onchange: () => {
      options.navmesh = navmesh.checked;
      plan.layers.floor.classList.toggle("off", !navmesh.checked);
    } });
    const switches = element("div", { class: "row switches" }, element("label", {}, navmesh, " navmesh"), explorer.zoom(holder, options, () => plan, draw));
    const levels = explorer.levels(scene);
    if (levels.length > 1) {
      const choice = element("select", { "aria-label": "Storey", onchange: () => {
        options.level = choice.value === "" ? null : Number(choice.value);
        draw();
      } }, element("option", { value: "" }, "all storeys"), levels.map((level) => element("option", { value: level }, `storey ${level}`)));
      switches.append(choice);
    }
    if (!scene.rooms.length) switches.append(element("span", { class: "note" }, "An export has no furniture; name its configuration to see it."));
    const resized = explorer.later(() => { if (holder.isConnected && Math.abs(holder.clientWidth - plan.width) > 2) draw(); }, 120);
    new ResizeObserver(resized).observe(holder);
    return { node: element("div", { class: "plan-panel" }, holder, switches, legend(episode)), draw };
  }

  /* Every line of the plan with its meaning: leaves by number, then the marks; agents have theirs beside their names. */
  function legend(episode) {
    const ways = episode.leaves.map((leaf) => [kindOf(episode, leaf), leaf.leaf === episode.gold ? `★ leaf ${tag(leaf)}, gold` : `leaf ${tag(leaf)}`]);
    if (episode.looking) ways.push(["looking", `looking path to it, ${number(episode.looking.length, 1)} m`]);
    const stops = episode.leaves.some((leaf) => leaf.stops.length) ? [element("li", {}, element("span", { class: "key stop" }, "a"), element("span", { class: "key stop" }, "b"), "stops before the goal, in their order")] : [];
    const entries = [["start", "start and heading"], ["witness", "witness"], ["rival", "rival or elsewhere"], ["anchor", "anchor"]];
    return element("ul", { class: "legend", "aria-label": "Legend of the plan" }, ways.map(([kind, text]) => element("li", {}, explorer.sample(kind), text)), stops,
      entries.map(([kind, text]) => element("li", {}, element("span", { class: `key ${kind}` }), text)));
  }

  function fact(name, value) {
    return [element("dt", {}, name), element("dd", { "data-fact": name }, value)];
  }

  function axes(episode) {
    const seen = episode.observability === "O0" && episode.in_view ? "O0f" : episode.observability;
    return element("dl", { class: "facts-list" },
      fact("scene", link(`${episode.source}/${episode.scene}`, `scene/${encodeURIComponent(`${episode.source}/${episode.scene}`)}`)),
      fact("split", episode.split), fact("category", meaning(episode.category)),
      fact("composition", meaning(episode.composition)),
      fact("observability", `${meaning(seen)}${episode.approximate ? " (by boxes)" : ""}`),
      fact("moves on the gold leaf", String(episode.moves)), fact("words", String(episode.words)),
      fact("straight to the goal", `${number(episode.geodesic_distance)} m`), fact("by all stops", `${number(episode.route_length)} m`),
      fact("success distance", `${number(episode.success_distance, 1)} m`), fact("step budget", `${episode.max_steps} steps`),
      fact("start heading", `${number(episode.heading, 0)}° clockwise from north`),
      fact("certificate", certificate(episode)));
  }

  function certificate(episode) {
    const proof = episode.certificate;
    if (!proof) return episode.split !== "not exported" ? "none; condvln verify writes them" : "none: condvln verify proves what is exported, and this episode is in no split";
    if (proof.proven) return `proven, ${proof.facts} facts of ${proof.kinds} kinds agree`;
    const kinds = proof.disagreements.map((one) => one.fact || one.kind || "").filter(Boolean);
    return `not proven: ${proof.disagreements.length} disagreements ${kinds.join(", ")}`;
  }

  function leafTable(episode, scene) {
    const rows = episode.leaves.map((leaf) => [
      `${leaf.leaf}${leaf.leaf === episode.gold ? " ★ gold" : ""}`, explorer.thing(scene, leaf.object), leaf.stops.map((stop) => explorer.thing(scene, stop.object)).join(", ") || "–",
      number(leaf.geodesic_distance), number(leaf.route_length)]);
    return element("div", { class: "stacked" }, explorer.table("Leaves", ["leaf", "goal", "stops before it", "#direct, m", "#by its stops, m"], rows, "leaves"));
  }

  function outcomeText(row, agent) {
    const found = explorer.index.agents.find((one) => one.name === agent);
    if (!found || !found.outcome[row]) return "not scored";
    const leaf = found.scores.committed_leaf?.[row];
    const name = explorer.index.outcomes[found.outcome[row]];
    const away = name === "no commit" ? found.scores.navigation_error?.[row] : null; // to the gold leaf's
    return leaf >= 0 ? `${name}, leaf ${leaf}` : away > 0 ? `${name}, ${number(away)} m from the nearest goal point of the gold leaf` : name;
  }

  function agentTable(row) {
    const rows = explorer.index.agents.filter((agent) => agent.outcome[row]).map((agent) => [
      agent.name, outcomeText(row, agent.name), ...explorer.index.metrics.map(([key]) => number(agent.scores[key]?.[row]))]);
    const headings = explorer.index.metrics.map(([, heading, kind]) => `#${heading}${kind === "metres" ? ", m" : ""}`);
    return rows.length ? element("div", { class: "stacked" }, explorer.table("Agents on this episode", ["agent", "outcome", ...headings], rows, "agents-here")) : null;
  }

  function frames(episode) {
    if (!episode.frames.length) return null;
    return element("section", { class: "seen-frames" }, element("h2", {}, "What is seen"),
      element("p", { class: "note" }, "Drawn from the dataset's own geometry. Things without a texture have one colour for each label; nothing is known where it is grey."), element("div", { class: "frames" },
      episode.frames.map((frame) => element("figure", {}, element("img", { src: frame.file, alt: frame.caption, loading: "lazy" }),
        element("figcaption", {}, frame.caption)))));
  }

  /* Return one episode as a node, whole or small (for groups side by side), and `shown`, to be called when it is in
     the page. `chosen` names the agents whose walks are drawn at first. */
  explorer.episodePanel = async (row, small, kept = () => {}, tagged = (episode) => episode, chosen = []) => {
    const episode = tagged(await explorer.loadEpisode(row));
    const [scene, walks] = await Promise.all([explorer.load(`scene-${explorer.index.columns.scene[row]}`), explorer.loadWalks(row)]);
    const drawn = drawing(episode);
    const details = element("div", { class: "details" }, element("p", { class: "note" }, "Point at a condition, or choose it, to see what decides it."));
    const root = element("div", { class: small ? "episode small" : "episode" });
    function choose(about, keep) {
      const fixed = drawn.choose(about, keep);
      const now = about || fixed;
      if (keep) kept(fixed);
      for (const node of root.querySelectorAll("[data-condition], [data-leaf]")) {
        const same = now && (now.condition !== undefined ? node.dataset.condition === String(now.condition) : node.dataset.leaf === String(now.leaf));
        node.classList.toggle("lit", Boolean(same));
        node.setAttribute("aria-pressed", String(Boolean(same && fixed)));
      }
      if (now?.condition !== undefined) details.replaceChildren(explorer.facts(episode, now.condition, scene));
    }
    const decided = Object.entries(episode.views || {}).map(([k, view]) => [explorer.letter(Number(k)), view.at]);
    const playback = !small && Object.keys(walks).length ? new explorer.Playback(walks, (agent) => outcomeText(row, agent), decided, chosen) : null;
    const panel = planPanel(scene, episode, drawn, playback && ((plan) => playback.attach(plan)));
    root.append(
      element("div", { class: "left" }, panel.node, playback && playback.node, small ? null : [agentTable(row), leafTable(episode, scene), frames(episode)]),
      element("div", { class: "right" }, explorer.instructionText(episode, choose), explorer.tree(episode, choose), details,
        small ? agentTable(row) : axes(episode)));
    return { node: root, episode, shown: panel.draw, choose };
  };

  /* A kept condition or leaf is part of the address: mark=B or mark=2. */
  const named = (about) => (about ? (about.condition === undefined ? String(about.leaf) : explorer.letter(about.condition)) : "");
  function marked(name, episode) {
    const all = [...episode.program.conditions.map((_, condition) => ({ condition })), ...episode.leaves.map(({ leaf }) => ({ leaf }))];
    return all.find((about) => named(about) === name);
  }

  /* The view of an episode: #/episode/ID, with the filter of the list it came from. */
  explorer.views.episode = async (main, path, asked) => {
    const { index } = explorer;
    const row = index.rows.get(path[0]);
    if (row === undefined) throw new Error(`there is no episode ${path[0]}`);
    const found = await explorer.filter(asked);
    const at = found.indexOf(row);
    const before = at > 0 ? index.columns.id[found[at - 1]] : null;
    const after = at >= 0 && at < found.length - 1 ? index.columns.id[found[at + 1]] : null;
    const { mark, ...list } = asked;
    // The agent whose outcome was followed, or those that the list is filtered by.
    const chosen = list.walk ? [list.walk] : index.agents.map((agent) => agent.name).filter((name) => list[`agent:${name}`]);
    const panel = await explorer.episodePanel(row, false, (about) => history.replaceState(null, "", explorer.address(`episode/${path[0]}`, { ...list, mark: named(about) })), undefined, chosen);
    const group = index.columns.group[row];
    const place = at < 0 ? "not in this list" : `${explorer.count(at + 1)} of ${explorer.count(found.length)}`;
    main.replaceChildren(
      element("div", { class: "row heading" }, element("h1", {}, `Episode ${panel.episode.id}`),
        link("◀ Back to the list", "browse", { ...list, page: at < 0 ? "" : String(Math.floor(at / explorer.PAGE) + 1) }, { id: "back" }),
        before && link("← Previous", `episode/${before}`, list, { id: "previous", rel: "prev" }), element("span", { id: "place" }, place),
        after && link("Next →", `episode/${after}`, list, { id: "next", rel: "next" }),
        group >= 0 && link("Its counterfactual group", `group/${group}`, {}, { id: "group" })),
      panel.node);
    panel.shown();
    const about = marked(mark, panel.episode);
    if (about) panel.choose(about, true);
    return `Episode ${panel.episode.id}`;
  };

  /* What makes two goals the same: the object, and the stops before it. */
  const goalKey = (leaf) => [...leaf.stops.map((stop) => stop.object), leaf.object].join("\n");
  const goalName = (episode, leaf) => explorer.leafName(episode.program.leaves[leaf.leaf]);

  /* Return an episode whose leaves have the numbers of the same goals in the first episode. */
  function tagged(first) {
    const known = first.leaves.map(goalKey);
    return (episode) => ({ ...episode, leaves: episode.leaves.map((leaf) => {
      const at = known.indexOf(goalKey(leaf));
      if (at < 0) known.push(goalKey(leaf));
      return { ...leaf, tag: at < 0 ? known.length - 1 : first.leaves[at]?.leaf ?? at };
    }) });
  }

  /* Return in words what differs between an episode of a group and the first one. */
  function changes(first, own) {
    const said = [];
    own.program.conditions.forEach((one, k) => {
      const was = first.program.conditions[k];
      const [now, before] = [one, was].map((condition) => condition && explorer.conditionName(condition));
      if (now !== before) said.push(`${explorer.letter(k)} asks for “${now}” (${one.truth}), not “${before}” (${was?.truth})`);
      else if (one.truth !== was.truth) said.push(`${explorer.letter(k)} is ${one.truth}, not ${was.truth}`);
    });
    const moved = own.leaves.filter((leaf) => tag(leaf) !== leaf.leaf);
    if (moved.length) said.push(`${moved.map((leaf) => goalName(own, leaf)).join(" and ")} have changed places in the text`);
    const [gold, before] = [own, first].map((episode) => goalName(episode, episode.leaves.find((leaf) => leaf.leaf === episode.gold)));
    said.push(gold === before ? `the gold goal is still ${gold}` : `so the gold goal is ${gold}, not ${before}`);
    return `${said.join("; ")}.`;
  }

  /* The view of a counterfactual group: its episodes side by side. */
  explorer.views.group = async (main, path) => {
    const rows = explorer.filter({ group: path[0] });
    if (!rows.length) throw new Error(`there is no group ${path[0]}`);
    const first = await explorer.loadEpisode(rows[0]);
    const panels = await Promise.all([...rows].map((row) => explorer.episodePanel(row, true, undefined, tagged(first))));
    const other = (group, id, label) => group >= 0 && group < explorer.index.groups && link(label, `group/${group}`, {}, { id });
    const at = Number(path[0]);
    main.replaceChildren(element("div", { class: "row heading" }, element("h1", {}, "Counterfactual group"), link("◀ Back to the list", "browse", { group: "any" }, { id: "back" }),
      other(at - 1, "previous", "← Previous"), element("span", {}, `${at + 1} of ${explorer.index.groups}`), other(at + 1, "next", "Next →")),
      element("p", {}, "One start; a condition has the other truth, or two leaves are exchanged. A goal has the same number and colour in all plans; the star is the gold one."),
      element("div", { class: "side-by-side" }, panels.map((panel, k) => element("section", { "aria-label": `Episode ${panel.episode.id}` },
        element("h2", {}, link(`Episode ${panel.episode.id}`, `episode/${panel.episode.id}`, { group: path[0] })),
        element("p", { class: "changed" }, k ? `Changed: ${changes(first, panel.episode)}` : "The others are compared with this one."), panel.node))));
    for (const panel of panels) panel.shown();
    return "Counterfactual group";
  };
}
