"use strict";
/* The plan of a scene from above, north up: navmesh, rooms, furniture to scale, and over them what a view adds. */

{
  const MARGIN = 14;
  const BELOW = 18;  // room for the scale
  const FLAT = new Set(["floor", "ceiling"]);
  const FONT = 11;
  const SMALL = 16;  // pixels: what is smaller gets a ring where it is marked
  const { svg } = explorer;

  /* Places labels one after the other and leaves out those that would cover another. */
  class Labels {
    constructor(width, height) {
      Object.assign(this, { width, height, taken: [] });
    }

    /* Return where a text of a size fits around a point, or null. */
    place(x, y, text, size, offsets = [[0, 0]]) {
      const half = (explorer.shown(text).length * size * 0.56) / 2 + 2;
      for (const [dx, dy] of offsets) {
        const box = [x + dx - half, y + dy - size * 0.6, x + dx + half, y + dy + size * 0.6];
        const inside = box[0] >= 0 && box[1] >= 0 && box[2] <= this.width && box[3] <= this.height;
        if (inside && this.taken.every((b) => box[2] <= b[0] || b[2] <= box[0] || box[3] <= b[1] || b[3] <= box[1])) {
          this.taken.push(box);
          return [x + dx, y + dy];
        }
      }
      return null;
    }

    reserve(x, y, radius) {
      this.taken.push([x - radius, y - radius, x + radius, y + radius]);
    }
  }

  function bounds(scene, more) {
    const xs = [];
    const zs = [];
    const add = (x, z) => { xs.push(x); zs.push(z); };
    for (const room of scene.rooms) for (const [x, z] of room.polygon || []) add(x, z);
    const outlined = xs.length > 0;  // what lies outside all rooms does not make them small
    for (const item of scene.objects) if (!outlined) for (const part of item.shape) for (let k = 0; k < 8; k += 2) add(part[k], part[k + 1]);
    for (const polygon of scene.floor) if (!outlined) for (let k = 1; k < polygon.length; k += 2) add(polygon[k], polygon[k + 1]);
    for (const [x, , z] of more) add(x, z);
    if (!xs.length) return [-1, -1, 1, 1];
    const least = (values) => values.reduce((a, b) => Math.min(a, b));
    const most = (values) => values.reduce((a, b) => Math.max(a, b));
    return [least(xs), least(zs), most(xs), most(zs)];
  }

  /* The drawing of one scene. Layers are groups, later ones above.

     options.points: positions that must fit in; options.named: ids of objects whose labels come first;
     options.level: only this storey; options.pick: called with an object that is chosen. */
  class Plan {
    constructor(container, scene, options = {}) {
      Object.assign(this, { container, scene, options });
      this.level = options.level ?? null;
      this.shapes = new Map();
      this.labelOf = new Map();
      this.draw();
    }

    draw() {
      const { scene, options } = this;
      const [west, north, east, south] = bounds(scene, options.points || []);
      const width = Math.max(280, this.container.clientWidth || 640);
      const high = options.height || Math.max(300, Math.min(window.innerHeight * 0.72, 720));
      this.scale = Math.min((width - 2 * MARGIN) / Math.max(east - west, 0.5), (high - 2 * MARGIN) / Math.max(south - north, 0.5));
      const height = Math.max(160, (south - north) * this.scale + 2 * MARGIN + BELOW);
      const { times = 1, at = [(west + east) / 2, (north + south) / 2] } = options.zoom || {};
      const fitted = this.scale;
      this.scale *= times;
      const middle = times === 1 ? (south - north) * fitted / 2 + MARGIN : height / 2;
      this.x = (value) => (value - at[0]) * this.scale + width / 2;
      this.y = (value) => (value - at[1]) * this.scale + middle;
      this.place = (x, y) => [(x - width / 2) / this.scale + at[0], (y - middle) / this.scale + at[1]];
      this.width = width;
      this.height = height;
      this.labels = new Labels(width, height);
      this.shapes.clear();
      this.labelOf.clear();
      this.names = [];
      this.node = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, class: "plan", role: "group",
        "aria-label": options.title || "Plan from above, north up" });
      this.layers = {};
      for (const name of ["rooms", "floor", "objects", "rays", "paths", "walk", "marks", "labels", "named"]) {
        this.layers[name] = svg("g", { class: `layer-${name}` });
        this.node.append(this.layers[name]);
      }
      if (options.navmesh === false) this.layers.floor.classList.add("off");
      this.drawRooms();
      this.drawFloor();  // over the walls, so that they are open where one can walk
      this.drawObjects();
      if (options.over) options.over(this);
      this.labelThings();
      for (const id of this.names) this.labelOf.get(id)?.classList.add("off");  // they are written as marked
      this.drawScale();
      this.container.replaceChildren(this.node);
    }

    /* Whether a height belongs to the storey that is shown. */
    on(y) {
      if (this.level === null) return true;
      const floors = this.scene.rooms.map((room) => [room.level, room.floor]);
      const nearest = floors.reduce((best, one) => {
        const off = y - one[1] < -0.4 ? 99 : Math.abs(y - one[1]);
        return off < best[1] ? [one[0], off] : best;
      }, [this.level, 98]);
      return nearest[0] === this.level;
    }

    points(values) {
      return values.map(([x, z]) => `${this.x(x).toFixed(1)},${this.y(z).toFixed(1)}`).join(" ");
    }

    drawFloor() {
      const parts = [];
      for (const polygon of this.scene.floor) {
        if (!this.on(polygon[0])) continue;
        for (let k = 1; k < polygon.length; k += 2) {
          parts.push(`${k === 1 ? "M" : "L"}${this.x(polygon[k]).toFixed(1)} ${this.y(polygon[k + 1]).toFixed(1)}`);
        }
        parts.push("Z");
      }
      this.layers.floor.append(svg("path", { d: parts.join(""), class: "floor" }));
    }

    drawRooms() {
      for (const room of this.scene.rooms) {
        if (!room.polygon || (this.level !== null && room.level !== this.level)) continue;
        this.layers.rooms.append(svg("polygon", { points: this.points(room.polygon), class: "room", "data-room": room.id },
          svg("title", {}, `${room.label} (${room.id})`)));
      }
    }

    drawObjects() {
      const { scene, options } = this;
      const big = (item) => item.shape.reduce((sum, p) => sum + Math.hypot(p[0] - p[2], p[1] - p[3]) * Math.hypot(p[2] - p[4], p[3] - p[5]), 0);
      const ordered = scene.objects.map((item, number) => [item, number, big(item)]).sort((a, b) => b[2] - a[2]);
      for (const [item, number] of ordered) {
        const room = scene.rooms[item.room];
        if (item.structure && FLAT.has(item.label)) continue;  // they would cover everything
        if (this.level !== null && room && room.level !== this.level) continue;
        const parts = item.shape.map((p) => svg("polygon", { points: this.points([[p[0], p[1]], [p[2], p[3]], [p[4], p[5]], [p[6], p[7]]]) }));
        if (!parts.length) parts.push(svg("circle", { cx: this.x(item.center[0]), cy: this.y(item.center[2]), r: 3 }));
        const shape = svg("g", { class: `object${item.hidden ? " hidden" : ""}${item.seeable === false && !item.hidden ? " unseeable" : ""}${item.structure ? " structure" : ""}`, "data-object": item.id },
          svg("title", {}, `${item.label} (${item.id})${room ? `, ${room.label}` : ""}`), parts);
        if (options.pick) shape.addEventListener("click", () => options.pick(item, number));
        this.layers.objects.append(shape);
        this.shapes.set(item.id, shape);
      }
      this.ordered = ordered;
    }

    labelThings() {
      const named = new Set(this.options.named || []);
      for (const room of this.scene.rooms) {
        if (!room.polygon || (this.level !== null && room.level !== this.level)) continue;
        const xs = room.polygon.map((corner) => this.x(corner[0]));
        const ys = room.polygon.map((corner) => this.y(corner[1]));
        const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
        const around = [[0, 0], [0, -16], [0, 16], [0, -34], [0, 34], [-30, 0], [30, 0]];
        this.label(middle(xs), middle(ys), room.label, "room-label", FONT + 1, around);
      }
      const first = this.ordered.filter(([item]) => named.has(item.id));
      const others = this.ordered.filter(([item]) => !named.has(item.id));
      for (const [item] of [...first, ...others]) {
        if (!this.shapes.has(item.id) || item.structure) continue;
        const wanted = named.has(item.id);
        const around = wanted ? [[0, 0], [0, -12], [0, 12], [34, 0], [-34, 0], [0, -22], [0, 22]] : [[0, 0]];
        const label = this.label(this.x(item.center[0]), this.y(item.center[2]), item.label, wanted ? "object-label named" : "object-label", FONT - 1, around);
        if (label) this.labelOf.set(item.id, label);
      }
    }

    label(x, y, text, kind, size, around) {
      const at = this.labels.place(x, y, text, size, around);
      const node = at && svg("text", { x: at[0], y: at[1] + size * 0.35, class: kind, "font-size": size }, text);
      if (node) this.layers.labels.append(node);
      return node;
    }

    drawScale() {
      const metres = [5, 2, 1, 0.5].find((length) => length * this.scale < this.width / 4) || 0.5;
      const y = this.height - 6;
      this.layers.labels.append(
        svg("path", { d: `M8 ${y - 4}V${y}H${8 + metres * this.scale}V${y - 4}`, class: "scale" }),
        svg("text", { x: 12, y: y - 4, class: "scale-label", "font-size": 10 }, `${metres} m · north ↑`));
    }

    /* Draw a way over positions [x, y, z]. */
    way(layer, path, kind) {
      const line = svg("polyline", { points: this.points(path.map((p) => [p[0], p[2]])), class: `way ${kind}` });
      this.layers[layer].append(line);
      return line;
    }

    /* Draw small shapes along a way, so that it is known without its colour. */
    beads(layer, path, kind, shape) {
      // At most about 500 beads, however long the path of a file from elsewhere is.
      let total = 0;
      for (let k = 1; k < path.length; k += 1) total += Math.hypot(this.x(path[k][0]) - this.x(path[k - 1][0]), this.y(path[k][2]) - this.y(path[k - 1][2]));
      const apart = Math.max(34, total / 500);
      let walked = apart / 2;
      for (let k = 1; k < path.length; k += 1) {
        const [x0, y0, x1, y1] = [this.x(path[k - 1][0]), this.y(path[k - 1][2]), this.x(path[k][0]), this.y(path[k][2])];
        const length = Math.hypot(x1 - x0, y1 - y0);
        for (; walked <= length; walked += apart) {
          const part = walked / length;
          this.layers[layer].append(explorer.bead(x0 + part * (x1 - x0), y0 + part * (y1 - y0), kind, shape));
        }
        walked -= length;
      }
    }

    /* Write the names of objects that are marked now, over everything else. */
    name(ids) {
      this.clear("named");
      this.names = ids;
      for (const [id, label] of this.labelOf) label.classList.toggle("off", ids.includes(id));
      const labels = new Labels(this.width, this.height);
      for (const id of ids) {
        const item = this.scene.objects.find((one) => one.id === id);
        if (!item || !this.shapes.has(id)) continue;
        const across = Math.max(0, ...item.shape.map((p) => Math.max(Math.hypot(p[0] - p[2], p[1] - p[3]), Math.hypot(p[2] - p[4], p[3] - p[5])))) * this.scale;
        const at = [this.x(item.center[0]), this.y(item.center[2])];
        if (across < SMALL) this.layers.named.append(svg("circle", { cx: at[0], cy: at[1], r: SMALL * 0.6, class: "ring" }));
        const around = [[0, -14], [0, 14], [0, -28], [0, 28], [46, 0], [-46, 0], [46, -16], [-46, 16]];
        const free = labels.place(...at, item.label, FONT, around);
        if (free) this.layers.named.append(svg("text", { x: free[0], y: free[1] + FONT * 0.35, class: "marked-label", "font-size": FONT }, item.label));
      }
    }

    /* Draw a mark with a short text on it. */
    mark(position, kind, text, title) {
      const [x, y] = [this.x(position[0]), this.y(position[2])];
      const shapes = {
        star: () => svg("path", { d: star(x, y, 15) }),
        goal: () => svg("rect", { x: x - 8, y: y - 8, width: 16, height: 16, rx: 3 }),
        stop: () => svg("circle", { cx: x, cy: y, r: 7 }),
        dot: () => svg("circle", { cx: x, cy: y, r: 2.5 }),
        eye: () => [svg("path", { d: `M${x - 11} ${y}Q${x} ${y - 13} ${x + 11} ${y}Q${x} ${y + 13} ${x - 11} ${y}Z` }), svg("circle", { cx: x, cy: y, r: 3.5 })],
      };
      const shape = kind.split(" ")[0];
      const node = svg("g", { class: `mark ${kind}` }, svg("title", {}, title || text), shapes[shape]());
      if (text && shape !== "dot") {
        node.append(svg("text", { x, y: y + (shape === "eye" ? 17 : 3.5), "font-size": 10, "text-anchor": "middle" }, text));
        this.labels.reserve(x, y, 9);
      }
      this.layers.marks.append(node);
      return node;
    }

    /* Draw an agent at a position with a heading in degrees clockwise from north. */
    arrow(layer, position, heading, kind, { length = 18, radius = 6, cone = 0 } = {}) {
      const [x, y] = [this.x(position[0]), this.y(position[2])];
      const turn = `rotate(${heading} ${x} ${y})`;
      const wide = cone * Math.SQRT1_2;  // a view of 90 degrees
      const node = svg("g", { class: `arrow ${kind}`, transform: turn },
        cone ? svg("path", { class: "cone", d: `M${x} ${y}L${x - wide} ${y - wide}A${cone} ${cone} 0 0 1 ${x + wide} ${y - wide}Z` }) : null,
        svg("circle", { cx: x, cy: y, r: radius }),
        svg("path", { d: `M${x} ${y}V${y - length}M${x - 5} ${y - length + 6}L${x} ${y - length}L${x + 5} ${y - length + 6}` }));
      this.layers[layer].append(node);
      this.labels.reserve(x, y, 10);
      return node;
    }

    /* Give objects a class, and take it from all others. */
    light(kind, ids) {
      for (const shape of this.shapes.values()) shape.classList.remove(kind);
      for (const id of ids) this.shapes.get(id)?.classList.add(kind);
    }

    clear(...layers) {
      for (const name of layers) this.layers[name].replaceChildren();
    }
  }

  /* The shapes of agents, in their order. */
  explorer.SHAPES = ["circle", "square", "triangle", "diamond"];
  explorer.bead = (x, y, kind, shape) => {
    const r = 3.6;
    const corners = { square: `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}Z`, triangle: `M${x} ${y - r - 1}l${r + 1} ${2 * r}h${-2 * r - 2}Z`,
      diamond: `M${x} ${y - r - 1.5}l${r + 1.5} ${r + 1.5}l${-r - 1.5} ${r + 1.5}l${-r - 1.5} ${-r - 1.5}Z` };
    return shape === "circle" ? svg("circle", { cx: x, cy: y, r, class: `bead ${kind}` }) : svg("path", { d: corners[shape], class: `bead ${kind}` });
  };

  /* Return a piece of a way as a sample for a legend; `shape` for an agent's. */
  explorer.sample = (kind, shape) => svg("svg", { viewBox: "0 0 38 14", class: "sample", "aria-hidden": "true" },
    svg("polyline", { points: "2,7 36,7", class: `way ${kind}` }), shape ? explorer.bead(19, 7, kind.replace("walk ", ""), shape) : null);

  function star(x, y, radius) {
    const corners = [];
    for (let k = 0; k < 10; k += 1) {
      const far = k % 2 ? radius * 0.45 : radius;
      const angle = (k * Math.PI) / 5 - Math.PI / 2;
      corners.push(`${(x + far * Math.cos(angle)).toFixed(1)} ${(y + far * Math.sin(angle)).toFixed(1)}`);
    }
    return `M${corners.join("L")}Z`;
  }

  explorer.Plan = Plan;

  /* Return buttons that zoom a plan in and out; a drag moves it, a double click zooms in there. `draw` draws it afresh with
     its options, `plan` returns what is drawn now. */
  explorer.zoom = (holder, options, plan, draw) => {
    let from = null;
    let moved = false;
    function to(times, at) {
      const { width, height } = plan();
      options.zoom = times <= 1.01 ? null : { times: Math.min(times, 12), at: at || plan().place(width / 2, height / 2) };
      holder.classList.toggle("zoomed", options.zoom !== null);
      draw();
    }
    const now = () => options.zoom?.times || 1;
    const inside = (event) => {
      const box = holder.getBoundingClientRect();
      return plan().place(event.clientX - box.left, event.clientY - box.top);
    };
    holder.addEventListener("dblclick", (event) => to(now() * 1.6, inside(event)));
    holder.addEventListener("pointerdown", (event) => { from = options.zoom ? inside(event) : null; moved = false; });
    holder.addEventListener("pointermove", (event) => {
      if (!from || !event.buttons) return;
      const here = inside(event);
      const step = [from[0] - here[0], from[1] - here[1]];
      if (!moved && Math.hypot(...step) * plan().scale < 4) return;
      moved = true;
      to(now(), [options.zoom.at[0] + step[0], options.zoom.at[1] + step[1]]);
    });
    holder.addEventListener("click", (event) => { if (moved) event.stopPropagation(); moved = false; }, true);
    const button = (text, label, act) => explorer.element("button", { type: "button", "aria-label": label, title: label, onclick: act }, text);
    return [button("+", "Zoom in", () => to(now() * 1.6)), button("−", "Zoom out", () => to(now() / 1.6)), button("Fit", "Show the whole plan", () => to(1))];
  };

  /* Return the label and id of an object, or of the room of a lead; the id alone where only an export is known. */
  explorer.thing = (scene, id) => {
    const found = [...scene.objects, ...scene.rooms].find((item) => item.id === id);
    return found ? `${found.label} (${id})` : id;
  };

  /* Return the storeys of a scene, sorted. */
  explorer.levels = (scene) => [...new Set(scene.rooms.map((room) => room.level))].sort((a, b) => a - b);
}
