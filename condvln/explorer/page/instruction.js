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
      const kind = condition >= 0 ? "clause condition" : `clause leaf${leaf === episode.gold ? " gold" : ""}`;
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
        element("b", {}, `${leaf} `), explorer.leafName(program.leaves[leaf]), gold ? " ★ gold" : "");
    }

    function branchNode(at) {
      const branch = program.branches[at];
      const condition = program.conditions[branch.condition];
      const side = (word, target, taken) => element("li", { class: taken ? "taken" : "" },
        element("span", { class: "word" }, word), " ", target >= 0 ? branchNode(target) : leafNode(-1 - target));
      const asked = onRoute.has(branch.condition);
      return element("div", { class: "branch" },
        pickable({ class: "condition", "data-condition": branch.condition }, { condition: branch.condition }, choose,
          element("b", {}, `${letter(branch.condition)} `), explorer.conditionName(condition), "? ",
          element("span", { class: condition.truth ? "true" : "false" }, condition.truth ? "✔ true" : "✘ false")),
        element("ul", {}, side("then", branch.then, asked && condition.truth), side("else", branch.otherwise, asked && !condition.truth)));
    }

    return element("div", { class: "tree", role: "group", "aria-label": "Decision tree" }, branchNode(0));
  };

  const LEVELS = { O0: "seen from the start", O1: "seen on the way that all leaves share", O2: "seen only after a detour" };

  /* Return what decides a condition: rule, things with measures, what the certificate says, and where it is seen. */
  explorer.facts = (episode, number_, scene) => {
    const condition = episode.program.conditions[number_];
    const facts = episode.facts?.[number_];
    const proof = episode.certificate?.conditions?.[number_];
    const evidence = episode.evidence.find((one) => one.condition === number_);
    const view = episode.views?.[number_];
    const lines = [element("h3", {}, `${letter(number_)}: ${explorer.conditionName(condition)} — ${condition.truth ? "true" : "false"}`)];
    if (facts) {
      const rows = facts.things.map((thing) => [
        explorer.thing(scene, thing.id), thing.role,
        thing.value === undefined || thing.value === null ? "–" : `${thing.measure} ${number(thing.value)} ${thing.unit}`,
        thing.margin === undefined || thing.margin === null ? "–" : number(thing.margin)]);
      lines.push(element("p", {}, `Rule: ${facts.rule}.`));
      lines.push(rows.length ? explorer.table("Things that decide it", ["thing", "role", "measure", "#margin"], rows, "facts")
        : element("p", {}, `No ${condition.label} is in this room, nor anywhere else in the scene.`));
    } else if (condition.witnesses.length) {
      lines.push(element("p", {}, `Witnesses: ${condition.witnesses.map((id) => explorer.thing(scene, id)).join(", ")}.`));
    }
    if (proof) {
      const numbers = Object.entries(proof.numbers).filter(([, value]) => value !== null).map(([name, value]) => `${name.replaceAll("_", " ")} ${number(value, 3)}`);
      lines.push(element("p", { class: "proof" },
        `Certificate: ${proof.truth ? "true" : "false"}${numbers.length ? `, ${numbers.join(", ")}` : ""}.`));
    }
    if (evidence) lines.push(element("p", { class: "seen" },
      `Evidence: ${LEVELS[evidence.observability] || evidence.observability}${evidence.in_view ? ", in the first view" : ""}.`));
    else lines.push(element("p", { class: "seen" }, "It is not asked on the gold route."));
    if (view) lines.push(element("p", { class: "first-seen" },
      `First seen ${number(view.walked, 1)} m along the gold path, marked with an eye on the plan.`));
    return element("div", { class: "facts" }, lines);
  };

  explorer.letter = letter;
}
