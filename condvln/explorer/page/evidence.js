"use strict";
/* What decides a condition, in words and numbers: the margin, the rule, the things that count, what the certificate
   says, and from where the evidence is first seen. */

{
  const { element, number } = explorer;
  const LEVELS = { O0: "seen from the start", O1: "seen on the way that all leaves share", O2: "not seen before the ways to the leaves part" };
  const WHOLE = 3;  // so many things are shown with all their quantities, the others with the one that decides
  /* Names and units of the certificate's numbers. */
  const PROVEN = {
    distance: ["distance", "m"], surface: ["distance between the surfaces", "m"], footprints_apart: ["distance between the footprints", "m"],
    step: ["height of its bottom over the anchor's top", "m"], covered: ["part of its footprint over the anchor", "%"],
    horizontal: ["distance of the centres on the ground", "m"], degrees_off: ["angle from the direction", "°"], elevation: ["angle above or below level", "°"],
    height: ["difference in height of the centres", "m"], tops: ["difference in height of the tops", "m"], air: ["gap in height", "m"],
    off_floor: ["height over the floor", "m"], inside: ["part inside the anchor", "%"], apart: ["distance", "m"],
    nearest_rival: ["distance of the nearest rival", "m"], off_line: ["distance from the line between the anchors", "m"],
    anchors_apart: ["distance between the anchors", "m"], part: ["place on the line between the anchors", "%"], volume_ratio: ["ratio of the volumes", ""],
    footprint_overlap: ["shared part of the smaller footprint", "%"],
  };
  const DIGITS = { m: 2, "°": 1, "%": 0 };

  explorer.measured = (value, unit) => {
    if (value === null || value === undefined) return "unknown";
    return `${number(value, DIGITS[unit] ?? 2)}${unit === "°" || !unit ? "" : " "}${unit}`;
  };

  function proven(name, value) {
    const [title, unit] = PROVEN[name] || [name.replaceAll("_", " "), ""];
    return `${title} ${explorer.measured(unit === "%" ? value * 100 : value, unit)}`;
  }

  const roomOf = (scene, id) => scene.rooms[scene.objects.find((item) => item.id === id)?.room];

  /* Return in a sentence why a condition is true or false. */
  function verdict(condition, facts, scene) {
    const first = facts.things[0];
    const label = condition.truth ? "✔ True" : "✘ False";
    const room = explorer.roomName(condition.room);
    if (!first) return `${label}: no ${condition.label} is in the ${room}, nor anywhere else in the scene.`;
    const name = explorer.thing(scene, first.id);
    if (first.role === "elsewhere") {
      const where = roomOf(scene, first.id)?.label || "another room";
      const apart = first.apart === null || first.apart === undefined ? "" : `, ${explorer.measured(first.apart, "m")} from the outline of the ${room}`;
      return `${label}: no ${condition.label} is in the ${room}. The nearest one is ${name} in the ${where}${apart}.`;
    }
    if (!condition.qualifier) {
      const share = scene.objects.find((item) => item.id === first.id)?.share;
      const seen = share === null || share === undefined ? "" : `; ${number(share * 100, 0)} % of its surface can be seen from where an agent can stand`;
      return `${label}: ${name} is in the ${room}${seen}.`;
    }
    if (!first.says) return `${label}: ${name} decides it.`;
    const others = facts.things.length > 1 && !condition.truth ? `, the closest call of ${facts.things.length}` : "";
    return `${label}: ${name}${others}: ${first.says}.`;
  }

  /* Return the rows of a thing: a quantity each, with its bounds; the one that decides is marked. */
  function rows(thing, whole, scene) {
    const name = explorer.thing(scene, thing.id);
    if (thing.role === "elsewhere") {
      return [[`${name}, in the ${roomOf(scene, thing.id)?.label || "scene"}`, "distance from this room's outline", explorer.measured(thing.apart, "m"), "", ""]];
    }
    if (!thing.criteria) return [[`${name}, ${thing.role}`, "", "", "", ""]];
    const margin = (one) => (one.decides ? explorer.measured(thing.margin, thing.unit) : "");
    const shown = thing.criteria.filter((one) => whole || one.decides);
    return (shown.length ? shown : thing.criteria.slice(0, 1)).map((one, k) => [
      k ? element("span", { class: "unseen" }, name) : `${name}, ${thing.role}`,
      one.decides ? element("b", {}, `${one.name} ◀ decides`) : one.name, explorer.measured(one.value, one.unit),
      [one.true && element("div", {}, `true: ${one.true}`), one.false && element("div", {}, `false: ${one.false}`)], margin(one)]);
  }

  /* Return where the looking walk decides a condition; nothing where there is no such walk. */
  function decidedAt(view) {
    if (!view) return "";
    const place = view.walked > 0 ? `${number(view.walked, 1)} m along the looking path` : "at the start";
    return `Decided ${place}, after ${view.frame} actions, marked with an eye on the plan.`;
  }

  /* Return what decides a condition. */
  explorer.facts = (episode, number_, scene) => {
    const condition = episode.program.conditions[number_];
    const facts = episode.facts?.[number_];
    const proof = episode.certificate?.conditions?.[number_];
    const evidence = episode.evidence.find((one) => one.condition === number_);
    const lines = [element("h3", {}, `${explorer.letter(number_)}: ${explorer.conditionName(condition)}`)];
    if (facts) {
      lines.push(element("p", { class: "verdict" }, verdict(condition, facts, scene)));
      lines.push(element("p", { class: "rule" }, `True if ${facts.rule}.`));
    } else {
      lines.push(element("p", { class: "verdict" }, condition.truth ? `✔ True: ${condition.witnesses.map((id) => explorer.thing(scene, id)).join(", ")}.` : "✘ False."));
    }
    if (proof) {
      const numbers = Object.entries(proof.numbers).filter(([, value]) => value !== null).map(([name, value]) => proven(name, value));
      // The certificate has the numbers of the first object that it looks at, and of that object's first parts.
      const several = facts && (facts.things.length > 1 || facts.things[0]?.parts > 1);
      const apart = several && numbers.length ? " (numbers of the first thing and part that it tests)" : "";
      lines.push(element("p", { class: "proof" },
        `Certificate, by other code: ${proof.truth}${apart}${numbers.length ? `; ${numbers.join(", ")}` : ""}.`));
    }
    if (evidence) lines.push(element("p", { class: "seen" },
      `Evidence: ${LEVELS[evidence.observability] || evidence.observability}${evidence.in_view ? ", in the first view" : ""}.`));
    else lines.push(element("p", { class: "seen" }, "It is not asked on the gold route."));
    const pictures = episode.frames.filter((one) => one.caption.endsWith(`where ${explorer.letter(number_)} is decided`));
    if (pictures.length) lines.push(element("div", { class: "frames" }, pictures.map((one) => element("figure", {}, element("img", { src: one.file, alt: one.caption }), element("figcaption", {}, one.caption)))));
    const where = evidence && decidedAt(episode.views?.[number_]);
    if (where) lines.push(element("p", { class: "first-seen" }, where));
    if (facts?.things.length) {
      const table = facts.things.flatMap((thing, k) => rows(thing, k < WHOLE, scene));
      lines.push(element("div", { class: "stacked" }, explorer.table("Things that the words can mean",
        ["thing", "quantity", "#value", "bounds", "#margin"], table, "facts")));
    }
    return element("div", { class: "facts" }, lines);
  };
}
