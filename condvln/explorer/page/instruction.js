"use strict";
/* The instruction with its clauses, the decision tree, and what decides a condition. All three speak of the same
   conditions and leaves: choosing one calls `choose({ condition })` or `choose({ leaf })`. */

{
  const { element, number } = explorer;

  const letter = (condition) => "ABCDEFGH"[condition] || String(condition + 1);

  function pickable(attributes, about, choose, ...children) {
    const act = (fixed) => choose(about, fixed);
    return element("span", {
      ...attributes, role: "button", tabindex: "0",
      onmouseenter: () => act(false), onfocus: () => act(false), onmouseleave: () => choose(null, false),
      onblur: () => choose(null, false), onclick: () => act(true),
      onkeydown: (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        act(true);
      },
    }, ...children);
  }

  function data(about) {
    return about.condition === undefined ? { "data-leaf": about.leaf } : { "data-condition": about.condition };
  }

  /* Return the text as a paragraph; clauses can be chosen. */
  explorer.instructionText = (episode, choose) => {
    const parts = [];
    let at = 0;
    for (const [start, end, condition, leaf] of episode.clauses) {
      if (start < at) continue;
      parts.push(episode.text.slice(at, start));
      const about = condition >= 0 ? { condition } : { leaf };
      const own = episode.leaves.find((one) => one.leaf === leaf)?.tag;
      const kind = condition >= 0 ? "clause condition" : `clause leaf ${own !== undefined ? `leaf-${own % 4}` : leaf === episode.gold ? "gold" : `leaf-${leaf % 4}`}`;
      parts.push(pickable({ class: kind, ...data(about) }, about, choose, episode.text.slice(start, end)));
      at = end;
    }
    parts.push(episode.text.slice(at));
    return element("p", { class: "instruction", dir: "auto" }, parts);
  };

  explorer.qualified = (qualifier) => {
    if (!qualifier) return "";
    return ` ${qualifier.predicate} ${qualifier.anchors.map((anchor) => anchor.label).join(" and ")}`.trimEnd();
  };
  explorer.roomName = (room) => room.label + (room.anchor_label ? ` with ${room.anchor_label}` : "");
  explorer.conditionName = (one) => `${one.label}${explorer.qualified(one.qualifier)} in ${explorer.roomName(one.room)}`;
  explorer.leafName = (leaf) => leaf.moves.map((move) => move.label + explorer.qualified(move.qualifier)).join(" → ");

  /* Return the decision tree as nested lists. */
  explorer.tree = (episode, choose) => {
    const { program } = episode;
    const onRoute = new Set(episode.route);

    function leafNode(leaf) {
      const gold = leaf === episode.gold;
      return pickable({ class: `leaf${gold ? " gold" : ""}`, "data-leaf": leaf }, { leaf }, choose,
        element("b", {}, `${episode.leaves.find((one) => one.leaf === leaf)?.tag ?? leaf} `), explorer.leafName(program.leaves[leaf]), gold ? " ★ gold" : "");
    }

    function branchNode(at) {
      const branch = program.branches[at];
      const condition = program.conditions[branch.condition];
      const side = (word, target, taken) => element("li", { class: taken ? "taken" : "" },
        element("span", { class: "word" }, word), " ", target >= 0 ? branchNode(target) : leafNode(-1 - target));
      const asked = onRoute.has(branch.condition);
      const lead = branch.lead ? element("div", { class: "lead" }, element("span", { class: "word" }, "go to"), ` ${explorer.roomName(branch.lead)}`) : "";
      return element("div", { class: "branch" }, lead,
        pickable({ class: "condition", "data-condition": branch.condition }, { condition: branch.condition }, choose,
          element("b", {}, `${letter(branch.condition)} `), explorer.conditionName(condition), "? ",
          element("span", { class: condition.truth ? "true" : "false" }, condition.truth ? "✔ true" : "✘ false")),
        element("ul", {}, side("then", branch.then, asked && condition.truth), side("else", branch.otherwise, asked && !condition.truth)));
    }

    return element("div", { class: "tree", role: "group", "aria-label": "Decision tree" }, branchNode(0));
  };

  explorer.letter = letter;
}
