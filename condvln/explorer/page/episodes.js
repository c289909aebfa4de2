"use strict";
/* The list of all episodes as typed columns, the filter over them, and the search in their texts. */

{
  const CHOICES = ["split", "source", "category", "composition", "observability", "gold_label"];
  const RANGES = ["depth", "chain", "moves", "words", "route_length", "geodesic_distance"];
  const LISTS = ["label", "predicate"];
  const NOT_SUCCESS = "not success";
  const SCORED = "scored";
  let index = null;
  let texts = null;

  function typed(values) {
    const Kind = values.every(Number.isInteger) ? Int32Array : Float32Array;
    return Kind.from(values, (value) => (value === null ? NaN : value));
  }

  /* Take over the chunk "index". */
  explorer.setIndex = (document) => {
    index = document;
    for (const name of Object.keys(index.columns)) {
      if (name !== "id") index.columns[name] = typed(index.columns[name]);
    }
    for (const list of LISTS) {
      index.lists[list].offsets = Int32Array.from(index.lists[list].offsets);
      index.lists[list].values = Int32Array.from(index.lists[list].values);
    }
    index.names.gold_label = index.names.label;
    for (const agent of index.agents) {
      agent.outcome = Uint8Array.from(agent.outcome);
      for (const name of Object.keys(agent.scores)) agent.scores[name] = typed(agent.scores[name]);
    }
    index.size = index.columns.id.length;
    index.rows = new Map(index.columns.id.map((id, row) => [id, row]));
    index.firsts = Int32Array.from(index.chunks);
    explorer.index = index;
  };

  /* Return the name of an episode's value in a column of names. */
  explorer.named = (column, row) => index.names[column][index.columns[column][row]];

  /* Return the number of the chunk that holds an episode. */
  explorer.chunkOf = (row) => {
    let low = 0;
    let high = index.firsts.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (index.firsts[middle] <= row) low = middle;
      else high = middle - 1;
    }
    return low;
  };

  explorer.loadEpisode = async (row) => {
    const chunk = explorer.chunkOf(row);
    return (await explorer.load(`episodes-${chunk}`))[row - index.firsts[chunk]];
  };
  explorer.loadWalks = async (row) => (await explorer.load(`walks-${explorer.chunkOf(row)}`))[index.columns.id[row]] || {};

  /* Return a promise of an episode's text for the list. */
  explorer.loadText = async (row) => {
    const size = index.texts.size;
    return (await explorer.load(`texts-${Math.floor(row / size)}`))[row % size];
  };

  /* Load all texts, in lower case, one string a chunk with the places where episodes begin. */
  explorer.loadTexts = () => {
    texts ||= (async () => {
      const found = [];
      for (let chunk = 0; chunk < index.texts.chunks; chunk += 1) {
        const own = await explorer.load(`texts-${chunk}`, false);
        const starts = new Int32Array(own.length + 1);
        const lowered = own.map((text) => text.toLowerCase().replaceAll("\n", " "));
        lowered.forEach((text, k) => { starts[k + 1] = starts[k] + text.length + 1; });
        found.push({ whole: lowered.join("\n"), starts, first: chunk * index.texts.size });
      }
      return found;
    })();
    return texts;
  };

  function withText(chunks, words) {
    const holds = new Uint8Array(index.size);
    for (const { whole, starts, first } of chunks) {
      let row = 0;
      for (let at = whole.indexOf(words); at >= 0; at = whole.indexOf(words, starts[row + 1])) {
        let high = starts.length - 1;  // the text that holds the place: the last one that starts before it
        while (row + 1 < high) {
          const middle = (row + high) >> 1;
          if (starts[middle] <= at) row = middle;
          else high = middle;
        }
        holds[first + row] = 1;
      }
    }
    return holds;
  }

  function range(text) {
    const [low, high] = String(text).split("..");
    return [low === "" ? -Infinity : Number(low), high === undefined ? Number(low) : high === "" ? Infinity : Number(high)];
  }

  function tests(asked) {
    const found = [];
    const { columns, names, lists } = index;
    for (const name of CHOICES) {
      if (!asked[name]) continue;
      const wanted = names[name].indexOf(asked[name]);
      const column = columns[name];
      found.push((row) => column[row] === wanted);
    }
    for (const name of RANGES) {
      if (!asked[name]) continue;
      const [low, high] = range(asked[name]);
      const column = columns[name];
      found.push((row) => column[row] >= low && column[row] <= high);
    }
    for (const name of LISTS) {
      if (!asked[name]) continue;
      const wanted = names[name].indexOf(asked[name]);
      const { offsets, values } = lists[name];
      const holds = new Uint8Array(index.size);
      for (let row = 0; row < index.size; row += 1) {
        for (let at = offsets[row]; at < offsets[row + 1]; at += 1) if (values[at] === wanted) holds[row] = 1;
      }
      found.push((row) => holds[row] === 1);
    }
    if (asked.scene) {
      const wanted = index.scenes.findIndex((scene) => `${scene.source}/${scene.id}` === asked.scene);
      found.push((row) => columns.scene[row] === wanted);
    }
    if (asked.group === "any") found.push((row) => columns.group[row] >= 0);
    else if (asked.group) found.push((row) => columns.group[row] === Number(asked.group));
    for (const agent of index.agents) {
      const value = asked[`agent:${agent.name}`];
      const wanted = index.outcomes.indexOf(value);
      const above = { [SCORED]: 0, [NOT_SUCCESS]: index.outcomes.indexOf("success") }[value];
      if (value) found.push(above === undefined ? (row) => agent.outcome[row] === wanted : (row) => agent.outcome[row] > above);
    }
    if (asked.differ) found.push((row) => new Set(index.agents.map((agent) => agent.outcome[row]).filter(Boolean)).size > 1);
    for (const name of ["untrue", "pictures"]) if (asked[name]) found.push((row) => columns[name][row] > 0 === (asked[name] === "some"));
    return found;
  }

  /* Return the numbers of the episodes that an address asks for, in order; a promise where texts must be loaded. */
  explorer.filter = (asked) => {
    const words = (asked.q || "").trim().toLowerCase();
    if (words && index.rows.has(words)) return Int32Array.of(index.rows.get(words));
    if (words) return explorer.loadTexts().then((chunks) => chosen(asked, withText(chunks, words)));
    return chosen(asked, null);
  };

  function chosen(asked, holds) {
    const all = tests(asked);
    const found = new Int32Array(index.size);
    let count = 0;
    for (let row = 0; row < index.size; row += 1) {
      if (holds && !holds[row]) continue;
      let kept = true;
      for (let k = 0; k < all.length && kept; k += 1) kept = all[k](row);
      if (kept) found[count++] = row;
    }
    return found.slice(0, count);
  }

  explorer.filters = { CHOICES, RANGES, LISTS, NOT_SUCCESS, SCORED };
}
