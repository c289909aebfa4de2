"use strict";
/* The page: addresses, keys, and the list of episodes that everything else needs. */

{
  const { element } = explorer;
  const main = document.getElementById("main");
  const TERMS = [
    ["leaf, gold leaf", "an end of the tree: stops in an order, the last one is the goal; the truths of the conditions lead to the gold one"],
    ["witness", "an object that makes a condition true"], ["rival", "another object that the condition's words can mean"],
    ["anchor", "the object that a relation is to: the bed in “near the bed”"],
    ["margin", "how far the deciding quantity is beyond its bound; what lies between the bounds of true and false is never used in text"],
    ["C0, C1, C2", "composition: all in one room; several rooms; a condition and its two leaves in three different rooms"],
    ["O0f, O0, O1, O2", "observability, from where the evidence is seen: in the first view; from the start by turning; on the way that all leaves share; after a detour only. In the tables' column O0 is O0f too"],
    ["NE, TL", "navigation error: metres from the end of the walk to the goal; length of the walk in metres"],
    ["SR, OSR", "success rate: the share of walks that stop within the success distance of the goal; OSR counts walks that come that near at any time"],
    ["SPL, SPL-route, SPL-look", "success weighted by the length of the shortest path to the goal; by the path through all stops; by the path that looks before it decides"],
    ["nDTW, SDTW, CLS, nDTW-look", "how close the walk is to the gold path; the same for successful walks only; coverage and length; how close to the path that looks"],
    ["BSA, CSR", "the share of stops reached in order before the first one is missed; the share of walks that reach all and succeed; “-all”: over all episodes"],
    ["wrong branch, no commit", "the walk ends at another leaf; it ends at no leaf"],
    ["right leaf, failed", "the walk ends at the gold leaf's goal and still failed, for example without STOP"],
    ["draws, candidates", "draws are programs that were tried; one that keeps all rules is a candidate, for which a start and paths are looked for"],
    ["goal point", "a place from which a level camera recognises the goal, near it; not every place beside it. A walk must end near one"],
    ["τ", "the success distance: so near to a goal point a walk must end"],
    ["beyond the balance", "an episode that was left out of the export, since with it the words alone would tell the answer"],
    ["bias gate", "guessers that see no scene try to find the right leaf; the export passes if none beats chance by a test that counts how many were tried (Holm)"],
    ["justified", "a success at which the agent had seen what decides the conditions, before it took its branch"],
    ["[low, high]", "95 % interval, scenes drawn with replacement; with one scene there is none"],
  ];
  const KEYS = [["→ or n", "next episode of the list"], ["← or p", "previous episode"], ["/", "search in texts"], ["Esc", "back to the list"],
    ["Tab, Enter", "go to a clause, a condition or a leaf, and keep it marked"]];
  let turn = 0;
  let linked = false; // a link was followed, not the browser's own back and forward, which keep their place
  let last = "";

  function address() {
    const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
    const asked = Object.fromEntries(new URLSearchParams(query || ""));
    const [view, ...rest] = (path || "browse").split("/");
    return { view, path: rest, asked };
  }

  explorer.views.help = (view) => {
    view.replaceChildren(element("h1", {}, "Help"),
      element("p", {}, "Each episode is an instruction with conditions. Its tree leads to one leaf, the gold one; the agent must go through that leaf's stops and stop at its goal."),
      element("p", {}, "Point at a clause, a condition or a leaf to see it on the plan. Choose it with a click or Enter to keep it marked. Every list, episode, scene and object has its own address, which can be sent to others."),
      element("p", {}, "Ranges are written from..to: 5..10, 5.. or ..10."),
      explorer.table("Keys", ["key", "what it does"], KEYS, "keys"),
      explorer.table("Words", ["word", "meaning"], TERMS, "terms"));
    return "Help";
  };

  async function show() {
    const own = (turn += 1);
    const { view, path, asked } = address();
    for (const tab of document.querySelectorAll("header nav a")) {
      const here = tab.dataset.view === view || (tab.dataset.view === "browse" && (view === "episode" || view === "group")) || (tab.dataset.view === "scenes" && view === "scene");
      if (here) tab.setAttribute("aria-current", "page");
      else tab.removeAttribute("aria-current");
    }
    const fresh = element("div", { class: `view view-${view}` });
    main.replaceChildren(fresh);
    let title = "Not found";
    try {
      if (!Object.hasOwn(explorer.views, view)) throw new Error(`there is no view ${view}`);
      title = await explorer.views[view](fresh, path, asked);
    } catch (error) {
      fresh.replaceChildren(element("h1", {}, "Nothing to show"), element("p", { role: "alert" }, error.message));
    }
    if (own !== turn) return;
    if (linked && view !== last) window.scrollTo(0, 0);
    linked = false;
    last = view;
    document.title = explorer.shown(`${title} · ${explorer.index.title}`);
    document.body.dataset.ready = String(own);
    performance.mark("shown");
    explorer.say(title);
  }

  function key(event) {
    const typing = event.target.closest("input, select, textarea");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const press = (id) => document.getElementById(id)?.click();
    if (event.key === "Escape") return void (typing ? typing.blur() : press("back"));
    if (typing) return;
    if (event.key === "ArrowRight" || event.key === "n") press("next");
    else if (event.key === "ArrowLeft" || event.key === "p") press("previous");
    else if (event.key === "/") {
      event.preventDefault();
      const field = document.getElementById("filter-q");
      if (field) field.focus();
      else location.hash = "#/browse";
    }
  }

  async function start() {
    try {
      explorer.setIndex(await explorer.load("index", false));
    } catch (error) {
      main.replaceChildren(element("p", { role: "alert" }, `The data can't be read: ${error.message}`));
      return;
    }
    document.getElementById("title").textContent = explorer.shown(explorer.index.title);
    window.addEventListener("hashchange", show);
    document.addEventListener("click", (event) => { linked = event.target.closest("a[href^='#']") !== null; });
    document.addEventListener("keydown", key);
    await show();
  }

  start();
}
