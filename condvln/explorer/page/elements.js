"use strict";
/* Elements of the page. Text becomes text nodes only: nothing from the data is ever read as markup. */

{
  const SVG = "http://www.w3.org/2000/svg";
  /* Control characters, and marks that change the direction of text, are shown by their code. */
  const HIDDEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u00ad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]/g;

  /* Return text in which every character can be seen. */
  explorer.shown = (text) =>
    String(text).replace(HIDDEN, (mark) => `⟨U+${mark.codePointAt(0).toString(16).toUpperCase().padStart(4, "0")}⟩`);

  function filled(node, attributes, children) {
    for (const [name, value] of Object.entries(attributes || {})) {
      if (value === null || value === undefined || value === false) continue;
      if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
      else node.setAttribute(name, value === true ? "" : explorer.shown(value));
    }
    for (const child of children.flat(9)) {
      if (child === null || child === undefined || child === false) continue;
      node.append(child instanceof Node ? child : document.createTextNode(explorer.shown(child)));
    }
    return node;
  }

  explorer.element = (tag, attributes, ...children) => filled(document.createElement(tag), attributes, children);
  explorer.svg = (tag, attributes, ...children) => filled(document.createElementNS(SVG, tag), attributes, children);

  /* Return a number for people: "–" where there is none. */
  explorer.number = (value, digits = 2) =>
    value === null || value === undefined || Number.isNaN(value) ? "–" : Number(value).toFixed(digits);
  explorer.count = (value) => Number(value).toLocaleString("en");

  /* Return a table. `columns` are headings, those of numbers begin with "#"; cells are texts, numbers or nodes. */
  explorer.table = (caption, columns, rows, name) => {
    const { element } = explorer;
    const numeric = columns.map((heading) => heading.startsWith("#"));
    const head = columns.map((heading, k) =>
      element("th", { scope: "col", class: numeric[k] ? "number" : null }, heading.replace(/^#/, "")));
    const body = rows.map((row) => element("tr", {}, row.map((cell, k) =>
      element(k === 0 ? "th" : "td", { scope: k === 0 ? "row" : null, class: numeric[k] ? "number" : null, "data-heading": columns[k].replace(/^#/, "") }, cell))));
    return element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
      element("table", { "data-table": name || null },
        element("caption", {}, element("span", {}, caption)), element("thead", {}, element("tr", {}, head)), element("tbody", {}, body)));
  };

  /* Let the rows of a table be sorted by each heading: numbers from the most, texts from A. */
  explorer.sortable = (node) => {
    const body = node.querySelector("tbody");
    const key = (row, k) => row.children[k].textContent.replaceAll(",", "");
    node.querySelectorAll("thead th").forEach((head, k) => {
      const numeric = head.classList.contains("number");
      const sort = () => {
        const down = head.getAttribute("aria-sort") === (numeric ? "descending" : "ascending") ? -1 : 1;
        const value = (row) => { const found = parseFloat(key(row, k)); return Number.isNaN(found) ? -1 : found; };
        const rows = [...body.children].sort((a, b) => down * (numeric ? value(b) - value(a) : key(a, k).localeCompare(key(b, k))));
        for (const other of node.querySelectorAll("thead th")) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", numeric === (down === 1) ? "descending" : "ascending");
        body.replaceChildren(...rows);
      };
      head.replaceChildren(explorer.element("button", { type: "button", class: "as-link", onclick: sort }, head.textContent));
    });
    return node;
  };

  /* What the codes of the axes mean. */
  const CODES = {
    C0: "all in one room", C1: "several rooms", C2: "the condition and its leaves are in three rooms",
    O0f: "all evidence is in the first view", O0: "all evidence is seen from the start by turning",
    O1: "evidence is seen on the way that all leaves share", O2: "evidence is seen after a detour only",
    simple: "one condition, two leaves", nested: "a condition within one side of another", chain: "if, else if, else: conditions tried one after the other",
    nested_chain: "a chain within one side of a condition", deep_nested: "conditions within conditions, three deep", long_chain: "three conditions tried one after the other",
  };
  explorer.meaning = (code) => CODES[code] || "";
  explorer.code = (code) => (CODES[code] ? explorer.element("abbr", { title: CODES[code] }, code) : String(code));

  /* Return a link to a view with parameters; empty ones are left out. */
  explorer.address = (path, parameters) => {
    const query = new URLSearchParams();
    for (const [name, value] of Object.entries(parameters || {})) {
      if (value !== "" && value !== null && value !== undefined) query.set(name, value);
    }
    const text = query.toString();
    return `#/${path}${text ? `?${text}` : ""}`;
  };
  explorer.link = (label, path, parameters, attributes) =>
    explorer.element("a", { href: explorer.address(path, parameters), ...attributes }, label);

  /* Say something to screen readers. */
  explorer.say = (text) => {
    document.getElementById("status").textContent = explorer.shown(text);
  };

  /* Call a function once, after the last of several calls. */
  explorer.later = (call, milliseconds) => {
    let timer = 0;
    return (...values) => {
      clearTimeout(timer);
      timer = setTimeout(() => call(...values), milliseconds);
    };
  };
}
