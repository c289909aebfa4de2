"use strict";
/* Counts over the episodes and over what became of their candidates. Each count of episodes is a link to them. */

{
  const { element, link, count } = explorer;
  const BINS = { route_length: 5, words: 20 };
  const MOST = 30;

  /* Return how many episodes have each value of a column of names, or of two columns. */
  function counted(...columns) {
    const { index } = explorer;
    const found = new Map();
    for (let row = 0; row < index.size; row += 1) {
      const key = columns.map((name) => explorer.named(name, row)).join("\u0001");
      found.set(key, (found.get(key) || 0) + 1);
    }
    return found;
  }

  function crossed(rowName, columnName) {
    const found = counted(rowName, columnName);
    const { names } = explorer.index;
    const across = [...names[columnName]].sort();
    const cell = (a, b) => {
      const value = found.get(`${a}\u0001${b}`) || 0;
      return value ? link(count(value), "browse", { [rowName]: a, [columnName]: b }) : "0";
    };
    const value = (a, b) => found.get(`${a}\u0001${b}`) || 0;
    const all = (a) => across.reduce((sum, b) => sum + value(a, b), 0);
    const down = [...names[rowName]].sort();
    const rows = down.map((a) => [link(a, "browse", { [rowName]: a }), ...across.map((b) => cell(a, b)), count(all(a))]);
    const title = `${explorer.TITLES[rowName]} by ${explorer.TITLES[columnName].toLowerCase()}`;
    const most = Math.max(...found.values());
    return element("section", {}, element("h3", {}, title),
      multiples(down.map((a) => bars([explorer.code(a), `: ${count(all(a))}`], across.map((b) => ({ label: b, value: value(a, b), address: value(a, b) ? explorer.address("browse", { [rowName]: a, [columnName]: b }) : null })), `${rowName}-${a}`, most))),
      numbers(explorer.table(title, [rowName, ...across.map((name) => `#${name}`), "#all"], rows, `${rowName}-${columnName}`)));
  }

  const multiples = (charts) => element("div", { class: "columns multiples" }, charts);
  const numbers = (table) => element("details", {}, element("summary", {}, "The numbers as a table"), table);
  const words = (name) => name.replaceAll("_", " ");

  /* Return a chart of horizontal bars; each has a label, a number and a link. `most` is the length of all charts that are
     compared. An entry `of` a whole is a part of that; `more` is said behind the number. */
  function bars(title, entries, name, most = Math.max(1, ...entries.map((one) => one.of ?? one.value))) {
    return element("section", { class: "bars", "data-bars": name }, element("h3", {}, title), element("ul", {},
      entries.map((one) => element("li", { title: one.title ?? (explorer.meaning(one.label) || null) }, one.address ? element("a", { href: one.address }, words(one.label)) : element("span", {}, words(one.label)),
        element("meter", { min: 0, max: one.of ?? most, value: one.value, "aria-label": `${one.label}: ${one.value}` }),
        element("span", { class: "value" }, count(one.value), one.of === undefined ? "" : ` of ${count(one.of)}`, one.more ?? "")))));
  }

  /* Return a chart for each value of the first column of some rows. */
  function bySource(rows, name, entry, title = (key) => key) {
    const found = Map.groupBy ? Map.groupBy(rows, title) : rows.reduce((all, row) => all.set(title(row), [...(all.get(title(row)) || []), row]), new Map());
    return multiples([...found].map(([key, own]) => bars(key, own.map(entry), `${name}-${key}`)));
  }

  function histogram(name) {
    const column = explorer.index.columns[name];
    const size = BINS[name];
    const found = new Map();
    for (const value of column) found.set(Math.floor(value / size), (found.get(Math.floor(value / size)) || 0) + 1);
    const entries = [...found.keys()].sort((a, b) => a - b).map((bin) => ({
      label: `${bin * size}–${(bin + 1) * size}`, value: found.get(bin),
      address: explorer.address("browse", { [name]: `${bin * size}..${((bin + 1) * size - 0.001).toFixed(3)}` }) }));
    return bars(explorer.TITLES[name], entries, name);
  }

  function listed(name, more = () => undefined) {
    const { values } = explorer.index.lists[name];
    const names = explorer.index.names[name];
    const found = new Int32Array(names.length);
    for (const value of values) found[value] += 1;
    const entries = [...found.keys()].sort((a, b) => found[b] - found[a]).slice(0, MOST).map((k) => ({
      label: names[k], value: found[k], more: more(names[k]), address: explorer.address("browse", { [name]: names[k] }) }));
    return bars(name === "label" ? `Labels that episodes name (first ${MOST})` : "Predicates of conditions", entries, name);
  }

  /* Return the share of the conditions with a predicate that are true, in words. */
  function trueShare([not, held]) {
    return not + held ? `, ${explorer.number((100 * held) / (not + held), 0)} % true` : "";
  }

  /* Return which predicates are asked in episodes of which source, each as "source predicate". */
  function askedBySource() {
    const { index } = explorer;
    const { offsets, values } = index.lists.predicate;
    const found = new Set();
    for (let row = 0; row < index.size; row += 1)
      for (let k = offsets[row]; k < offsets[row + 1]; k += 1) found.add(`${explorer.named("source", row)} ${index.names.predicate[values[k]]}`);
    return found;
  }

  function goldLabels() {
    const found = [...counted("gold_label")].sort((a, b) => b[1] - a[1]).slice(0, MOST);
    return bars(`Labels of gold goals (first ${MOST})`,
      found.map(([label, value]) => ({ label, value, address: explorer.address("browse", { gold_label: label }) })), "gold_label");
  }

  function funnel(rows) {
    const asked = (cell) => (cell === "counterfactual groups" ? { group: "any" } : { category: cell });
    return element("div", {}, element("p", { class: "note" }, "Episodes that were placed, of those wanted."),
      bySource(rows, "funnel", ([source, cell, wanted, , , placed]) => ({ label: cell, value: placed, of: wanted, address: explorer.address("browse", { source, ...asked(cell) }) }), (row) => row[0]),
      numbers(funnelTable(rows)));
  }

  function funnelTable(rows) {
    return explorer.table("Funnel: from candidates to episodes", ["source", "cell", "#wanted", "#candidates", "#rejected", "#placed"],
      rows.map((row) => [link(row[0], "browse", { source: row[0] }), row[1], ...row.slice(2).map(count)]), "funnel");
  }

  /* Return the reasons of rejection, each with its rule, the scenes where it is most frequent, and examples, whose
     objects are marked in the scene that they link to. */
  function rejections(rows) {
    const scene = (source, id, parameters) => link(id, `scene/${encodeURIComponent(`${source}/${id}`)}`, parameters);
    const named = rows.map((row) => [row.source, row.stage, row.reason, count(row.count), row.rule,
      element("ul", { class: "plain" }, row.places.map(([id, n]) => element("li", {}, scene(row.source, id, {}), `: ${count(n)}`))),
      row.examples.length ? element("details", {}, element("summary", {}, `${row.examples.length} ${row.examples.length === 1 ? "example" : "examples"}`),
        element("ul", { class: "plain" }, row.examples.map((one) => element("li", {},
          scene(row.source, one.scene, { mark: one.objects.join("\n") }), one.cell ? ` ${one.cell}: ` : ": ", element("bdi", {}, one.example))))) : "–"]);
    const place = (row) => (row.places.length ? explorer.address(`scene/${encodeURIComponent(`${row.source}/${row.places[0][0]}`)}`) : null);
    return element("div", {}, element("p", { class: "note" }, "What rejects most, each bar a link to the scene where it rejects most. Draws are programs that were tried; candidates are programs that could not be placed."),
      bySource(rows.filter((row, k) => rows.slice(0, k).filter((other) => other.source === row.source && other.stage === row.stage).length < 6), "rejections",
        (row) => ({ label: row.reason, value: row.count, title: row.rule || null, address: place(row) }), (row) => `${row.source}, ${row.stage === "programs" ? "draws" : "candidates"}`),
      numbers(rejectionTable(named)));
  }

  function rejectionTable(named) {
    return explorer.table("Why candidates were rejected", ["source", "stage", "reason", "#count", "rule", "most in", "examples"], named, "rejections");
  }

  function gate(found) {
    if (!found) return element("p", {}, "The bias gate was not run on this export.");
    const beating = found.findings.filter((one) => one.beats_chance);
    const shown = [...beating, ...found.findings.filter((one) => !one.beats_chance && one.source === "all" && one.category === "all" && one.predicate === "all")];
    return element("div", {}, element("p", { "data-gate": found.passed ? "passed" : "failed" }, `${found.passed ? "✔ passed" : "✘ not passed"}: ${found.verdict}`),
      explorer.table("Guessers that see no scene", ["guesser", "source", "category", "asks", "#episodes", "#accuracy", "#chance", "beats chance"],
        shown.map((one) => [one.guesser, one.source, one.category, one.predicate, count(one.episodes), one.accuracy.toFixed(3), one.chance.toFixed(3), one.beats_chance ? "✘ yes" : "no"]), "gate"));
  }

  function drift(found) {
    if (!found) return element("p", {}, "Nothing to compare with was given; --before takes a former export or snapshot.");
    const change = (was, now) => (now > was ? "+" : "") + (now - was);
    const scene = (source, id, now) => (explorer.index.scenes.some((one) => one.source === source && one.id === id)
      ? link(count(now), "browse", { scene: `${source}/${id}` }) : count(now));
    return element("div", {},
      element("p", { id: "drift" }, `Compared with ${found.before}: ${count(found.kept)} episodes are in both, ${count(found.reworded)} of them with another text; `
        + `${count(found.new)} are new, ${count(found.gone)} are gone.`),
      explorer.table("Episodes before and now", [found.by, "category", "#before", "#now", "#change"],
        found.cells.map(([name, category, was, now]) => [name, category, count(was), link(count(now), "browse", { [found.by]: name, category }), change(was, now)]), "drift"),
      found.scenes.length ? explorer.table("Scenes with another number of episodes", ["source", "scene", "#before", "#now", "#change"],
        found.scenes.map(([source, id, was, now]) => [source, id, count(was), scene(source, id, now), change(was, now)]), "drift-scenes") : "");
  }

  explorer.views.statistics = async (main) => {
    const found = await explorer.load("statistics");
    const { index } = explorer;
    const asked = askedBySource();
    const section = (title, ...nodes) => element("section", {}, element("h2", {}, title), nodes);
    main.replaceChildren(element("h1", {}, "Statistics"),
      element("p", { id: "totals" }, `${count(index.size)} episodes of ${count(index.scenes.length)} scenes, ${count(index.groups)} counterfactual groups`,
        index.snapshot ? ` · snapshot ${index.snapshot}` : ""),
      section("Episodes by cell", crossed("split", "category"), crossed("source", "category"), crossed("source", "split"),
        crossed("composition", "category"), crossed("observability", "category")),
      section("Lengths", element("div", { class: "columns" }, histogram("route_length"), histogram("words"))),
      section("Labels and predicates", element("div", { class: "columns" }, goldLabels(), listed("label"), listed("predicate", (name) => trueShare(found.asked?.[name] ?? [0, 0]))),
        element("p", { class: "note" }, "Numbers count episodes. Behind a predicate: the share of the conditions that ask for it and are true.")),
      found.relations.length ? section("Relations of the scenes", element("p", { class: "note" }, "Relations that text may state, of all that hold. A bar of what some episode asks is a link to those episodes."),
        bySource(found.relations, "relations", ([source, predicate, emitted, fit]) => ({ label: predicate, value: fit, of: emitted, address: asked.has(`${source} ${predicate}`) ? explorer.address("browse", { source, predicate }) : null }), (row) => row[0]),
        numbers(explorer.table("Emitted edges, and those that text may use", ["source", "predicate", "#emitted", "#fit for text"],
        found.relations.map((row) => [row[0], row[1], count(row[2]), count(row[3])]), "relations"))) : "",
      found.funnel.length ? section("Funnel", funnel(found.funnel)) : "",
      found.rejections.length ? section("Rejections", rejections(found.rejections)) : "",
      Object.keys(found.left_out).length ? section("Left out of the export", explorer.table("Why episodes were left out", ["reason", "#episodes"],
        Object.entries(found.left_out).map(([reason, value]) => [reason, count(value)]), "left-out")) : "",
      section("Bias gate", gate(found.gate)), section("Drift", drift(found.drift)));
    return "Statistics";
  };
}
