"use strict";
/* Agents compared: main table, sweeps over depth and chain with intervals, and the episodes where two differ. */

{
  const { element, svg, link, count } = explorer;
  const CHART = { width: 300, height: 170, left: 34, bottom: 24 };

  const AXES = { category: "category", depth: "depth", chain: "chain", source: "source", observability: "observability" };
  const FIRST = ["success", "spl_look", "bsa_all", "csr_all", "justified"];

  /* Return a cell with its interval beneath the number. */
  function stacked(text) {
    const parts = text.match(/^(\S+) (\[.*)$/);
    return parts ? [`${parts[1]} `, element("span", { class: "interval" }, parts[2])] : text;
  }

  /* Return the agent of a row as a link to the row's episodes, which are then shown with its walk. */
  function named(row, split) {
    const asked = Object.entries(row).filter(([name, value]) => AXES[name] && value !== "all").map(([name, value]) => [AXES[name], value]);
    return link(row.agent, "browse", { ...Object.fromEntries(asked), split, [`agent:${row.agent}`]: explorer.filters.SCORED }, { title: `Episodes of ${row.agent}, each with its walk` });
  }

  function whole(table) {
    return element("div", { "data-split": table.split }, explorer.table(`${table.title}, all measures (${table.split})`, table.headings, table.cells.map((row) => row.map(stacked)), table.name),
      table.note ? element("p", { class: "note" }, table.note) : "");
  }

  /* Return the measures that tell which agent is best, all sources first, the best of each block in bold; all others are
     in a table behind them. */
  function shown(table) {
    const keys = Object.keys(table.rows[0]);
    const names = keys.filter((_, k) => !table.headings[k].startsWith("#"));
    const over = names.filter((name) => name !== "agent");
    const used = [...names, ...FIRST.filter((name) => keys.includes(name)), "episodes"].filter((name) => keys.includes(name)).map((name) => keys.indexOf(name));
    const block = (row) => over.map((name) => row[name]).join();
    const best = (row, key) => row[key]?.mean > 0 && table.rows.every((other) => block(other) !== block(row) || !(other[key]?.mean > row[key].mean));
    const order = table.rows.map((row, k) => [over.some((name) => row[name] === "all") ? 0 : 1, k]).sort(([a, i], [b, j]) => a - b || i - j);
    const cells = order.map(([, n]) => used.map((k) => (keys[k] === "agent" ? named(table.rows[n], table.split) : best(table.rows[n], keys[k]) ? element("b", {}, stacked(table.cells[n][k])) : stacked(table.cells[n][k]))));
    return element("div", { "data-split": table.split },
      element("div", { class: "stacked" }, explorer.table(`${table.title} (${table.split})`, used.map((k) => table.headings[k]), cells, `${table.name}-first`)),
      table.cells.some((row) => row.some((cell) => cell.includes("["))) ? element("p", { class: "note" }, "Beneath a number: its 95 % interval, scenes drawn with replacement; a row without them comes from one scene. Bold: the best of its block.") : element("p", { class: "note" }, "No intervals: all episodes of a row come from one scene. Bold: the best of its block."),
      element("details", {}, element("summary", {}, "All measures"), whole(table)));
  }

  /* Return a chart of a measure over depth or chain, a line an agent with its 95 % interval. */
  function sweep(table, axis, measure, title, agents) {
    const { width, height, left, bottom } = CHART;
    const rows = table.rows.filter((row) => row[axis] !== "all" && row[measure]?.mean !== null && row[measure] !== undefined);
    const steps = [...new Set(rows.map((row) => String(row[axis])))].sort();
    const x = (step, k) => left + 20 + (steps.length > 1 ? (steps.indexOf(step) / (steps.length - 1)) * (width - left - 50) : 0) + k * 5;
    const y = (value) => 8 + (1 - value) * (height - bottom - 8);
    const node = svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "line-chart", role: "img", "aria-label": `${title} by ${axis}; the table has the numbers` },
      [0, 0.5, 1].map((value) => [svg("path", { class: "grid", d: `M${left} ${y(value)}H${width - 4}` }), svg("text", { x: left - 4, y: y(value) + 3, "font-size": 10, "text-anchor": "end" }, `${value * 100}`)]),
      steps.map((step) => svg("text", { x: x(step, 0), y: height - 8, "font-size": 10, "text-anchor": "middle" }, `${axis} ${step}`)));
    agents.forEach((agent, k) => {
      const own = rows.filter((row) => row.agent === agent);
      node.append(svg("polyline", { class: `way walk agent-${k % 4}`, points: own.map((row) => `${x(String(row[axis]), k)},${y(row[measure].mean)}`).join(" ") }));
      for (const row of own) {
        const at = x(String(row[axis]), k);
        const { low, high, mean } = row[measure];
        node.append(svg("g", { class: `point agent-${k % 4}`, "data-y": y(mean) }, svg("title", {}, `${agent}, ${axis} ${row[axis]}: ${(mean * 100).toFixed(1)}${low === null ? "" : ` [${(low * 100).toFixed(1)}, ${(high * 100).toFixed(1)}]`}`),
          low === null ? null : svg("path", { d: `M${at} ${y(low)}V${y(high)}` }), explorer.bead(at, y(mean), `agent-${k % 4}`, explorer.SHAPES[k % 4])));
      }
    });
    return element("figure", {}, element("figcaption", {}, `${title}, %`), node);
  }

  function key(agents) {
    return element("ul", { class: "legend" }, agents.map((agent, k) => element("li", {}, explorer.sample(`walk agent-${k % 4}`, explorer.SHAPES[k % 4]), agent)));
  }

  function sweeps(tables, measures) {
    return tables.filter((table) => table.name === "by_depth" || table.name === "by_chain").map((table) => {
      const axis = table.name.slice("by_".length);
      const agents = [...new Set(table.rows.map((row) => row.agent))];
      return element("section", {}, element("h3", {}, `By ${axis} (${table.split})`), key(agents),
        element("div", { class: "columns" }, measures.map(([measure, title]) => sweep(table, axis, measure, title, agents))), shown(table));
    });
  }

  /* Return how often each pair of outcomes of two agents occurs, with links to the episodes. */
  function compared(first, second) {
    const { outcomes, size } = explorer.index;
    const found = outcomes.map(() => new Int32Array(outcomes.length));
    for (let row = 0; row < size; row += 1) found[first.outcome[row]][second.outcome[row]] += 1;
    const used = outcomes.map((_, k) => k).filter((k) => k > 0 && found.some((own, j) => j > 0 && (own[k] || found[k][j])));
    const rows = used.map((j) => [`${first.name}: ${outcomes[j]}`, ...used.map((k) => (found[j][k]
      ? link(count(found[j][k]), "browse", { [`agent:${first.name}`]: outcomes[j], [`agent:${second.name}`]: outcomes[k] }) : "0"))]);
    return element("div", { class: "stacked" }, explorer.table(`What became of the same episodes: ${first.name} and ${second.name}`, ["episodes", ...used.map((k) => `#${second.name}: ${outcomes[k]}`)], rows, "compared"));
  }

  /* Return the tables of differences between two agents, by category, depth and so on. */
  function better(tables, first, second) {
    return tables.filter((table) => table.name === "differences").map((table) => {
      const between = (own, other) => table.cells.filter((row) => row[0] === own && row[1] === other);
      let own = between(first, second);
      if (!own.length) return "";
      // The better agent comes first, so that most differences are positive.
      if (parseFloat(own[0][4]) < parseFloat(own[0][5])) {
        [first, second] = [second, first];
        own = between(first, second);
      }
      const rows = own.map((row) => {
        const [, , axis, value, ...numbers] = row;
        const label = axis === "all" ? "all episodes" : `${axis} ${value}`;
        const asked = { split: table.split, [AXES[axis]]: value };
        return [axis === "all" ? link(label, "browse", { split: table.split }) : AXES[axis] ? link(label, "browse", asked) : label, ...numbers];
      });
      const heads = [`#SR of ${first}`, `#SR of ${second}`, ...table.headings.slice(6)];
      return element("div", { "data-split": table.split, class: "stacked" },
        explorer.table(`How much better ${first} is than ${second} (${table.split}), in percentage points`, ["episodes", ...heads], rows, "differences"),
        element("p", { class: "note" }, table.note));
    });
  }

  function comparison(tables) {
    const { agents } = explorer.index;
    if (agents.length < 2) return "";
    const holder = element("div", {});
    const choice = (start, id, title) => element("select", { id, "aria-label": title }, agents.map((agent, k) => element("option", { value: k, selected: k === start }, agent.name)));
    const one = choice(0, "first-agent", "First agent");
    const other = choice(1, "second-agent", "Second agent");
    const draw = () => holder.replaceChildren(compared(agents[one.value], agents[other.value]), ...better(tables, agents[one.value].name, agents[other.value].name));
    one.addEventListener("change", draw);
    other.addEventListener("change", draw);
    draw();
    return element("section", {}, element("h2", {}, "Two agents"), element("div", { class: "row" }, one, " and ", other), holder);
  }

  function outcomesOf() {
    const { agents, outcomes } = explorer.index;
    const used = outcomes.map((_, k) => k).filter((k) => k > 0 && agents.some((agent) => agent.outcome.includes(k)));
    const rows = agents.map((agent) => {
      const found = new Int32Array(outcomes.length);
      for (const value of agent.outcome) found[value] += 1;
      return [agent.name, ...used.map((k) => (found[k] ? link(count(found[k]), "browse", { [`agent:${agent.name}`]: outcomes[k] }) : "0"))];
    });
    return explorer.table(`What became of the episodes (${[...new Set(agents.flatMap((agent) => agent.splits))].join(", ")})`, ["agent", ...used.map((k) => `#${outcomes[k]}`)], rows, "outcomes");
  }

  explorer.views.agents = async (main) => {
    if (!explorer.index.agents.length) {
      main.replaceChildren(element("h1", {}, "Agents"), element("p", {}, "No predictions were given: condvln explore … --predictions FILE shows agents."));
      return "Agents";
    }
    const { tables, measures } = await explorer.load("agents");
    const rest = new Set(["main", "by_depth", "by_chain", "differences"]);
    main.replaceChildren(element("h1", {}, "Agents"), ...tables.filter((table) => table.name === "main").map(shown), outcomesOf(), comparison(tables) || "",
      element("h2", {}, "Depth and chain"), ...sweeps(tables, measures),
      element("details", {}, element("summary", {}, "All tables"), tables.filter((table) => !rest.has(table.name)).map(whole)));
    return "Agents";
  };
}
