"use strict";
/* Playback of agents' walks over a plan, with the distance to the goal at each step and the leaf committed to. */

{
  const { element, svg, number } = explorer;
  const STEP = 60;  // milliseconds between two poses
  const CHART = { width: 320, height: 110, left: 30, bottom: 18 };

  /* Controls for the walks of one episode. `outcome(agent)` says what became of it; `decided` has the letters of
     conditions and the places at which the looking path decides them; `chosen` names the agents to show at first, else the
     first two are. At first the whole walks are shown. */
  class Playback {
    constructor(walks, outcome, decided = [], chosen = []) {
      this.agents = Object.keys(walks);
      Object.assign(this, { walks, outcome, decided, timer: 0 });
      const own = this.agents.filter((agent) => chosen.includes(agent));
      this.shown = new Set(own.length ? own : this.agents.slice(0, 2));
      this.length = Math.max(...this.agents.map((agent) => walks[agent].path.length));
      this.step = this.length - 1;
      this.build();
    }

    build() {
      this.play = element("button", { type: "button", class: "play", onclick: () => this.toggle() }, "▶ Play");
      this.slider = element("input", { type: "range", min: 0, max: this.length - 1, value: this.length - 1, "aria-label": "Step of the walk",
        oninput: () => this.go(Number(this.slider.value)) });
      this.readout = element("div", { class: "readout" });
      const boxes = this.agents.map((agent, k) => element("label", { class: "agent" },
        element("input", { type: "checkbox", checked: this.shown.has(agent), "data-agent": agent, onchange: (event) => {
          if (event.target.checked) this.shown.add(agent);
          else this.shown.delete(agent);
          this.draw();
        } }), explorer.sample(`walk agent-${k % 4}`, explorer.SHAPES[k % 4]), agent));
      this.chart = element("div", { class: "chart" });
      this.node = element("section", { class: "playback", "aria-label": "Agents' walks" },
        element("h2", {}, "Agents' walks"), element("div", { class: "row" }, boxes),
        element("div", { class: "row" }, this.play, this.slider),
        this.decided.length ? element("div", { class: "row" }, "Nearest to where the looking path decides ", this.decided.map(([letter, at]) =>
          element("button", { type: "button", class: "decision", onclick: () => { this.stop(); this.go(this.nearest(at)); } }, letter))) : "", this.readout, this.chart);
    }

    /* Return the step at which the first shown agent is nearest to a place. */
    nearest(at) {
      const agent = this.agents.find((one) => this.shown.has(one)) || this.agents[0];
      const far = this.walks[agent].path.map((place) => Math.hypot(place[0] - at[0], place[2] - at[2]));
      return far.indexOf(Math.min(...far));
    }

    /* Draw on this plan from now on. */
    attach(plan) {
      this.plan = plan;
      this.draw();
    }

    toggle() {
      if (this.timer) return this.stop();
      if (this.step >= this.length - 1) this.step = 0;
      this.play.textContent = "❚❚ Pause";
      this.timer = setInterval(() => {
        if (!this.node.isConnected || this.step >= this.length - 1) this.stop();
        else this.go(this.step + 1);
      }, STEP);
      return undefined;
    }

    stop() {
      clearInterval(this.timer);
      this.timer = 0;
      this.play.textContent = "▶ Play";
    }

    go(step) {
      this.step = step;
      this.slider.value = String(step);
      this.draw();
    }

    draw() {
      this.plan.clear("walk");
      const rows = [];
      for (const [k, agent] of this.agents.entries()) {
        if (!this.shown.has(agent)) continue;
        const walk = this.walks[agent];
        const at = Math.min(this.step, walk.path.length - 1);
        const until = walk.path.slice(0, at + 1);
        this.plan.way("walk", until, `walk agent-${k % 4}`);
        this.plan.beads("walk", until, `agent-${k % 4}`, explorer.SHAPES[k % 4]);
        this.plan.arrow("walk", walk.path[at], heading(walk, at), `marker agent-${k % 4}`, { length: 20, radius: 9, cone: 46 });
        rows.push([agent, `${at} of ${walk.path.length - 1}`, number(walk.distance[at]), at === walk.path.length - 1 ? `${this.outcome(agent)}${walk.stopped ? "" : ", no STOP"}` : "under way"]);
      }
      const geodesic = this.agents.every((agent) => this.walks[agent].geodesic);
      const distance = geodesic ? "#metres to the gold goal at this step" : "#metres to the gold goal at this step (straight)";
      this.readout.replaceChildren(element("div", { class: "stacked" }, explorer.table("Where the agents are", ["agent", "step", distance, "outcome"], rows, "walks")));
      this.drawChart();
    }

    drawChart() {
      const { width, height, left, bottom } = CHART;
      const all = this.agents.flatMap((agent) => this.walks[agent].distance).filter((value) => value !== null);
      const most = Math.max(1, ...all);
      const x = (step) => left + (step / Math.max(1, this.length - 1)) * (width - left - 6);
      const y = (value) => 6 + (1 - value / most) * (height - bottom - 6);
      const node = svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "line-chart", role: "img",
        "aria-label": "Metres to the goal at each step; the table above has the numbers" },
        svg("path", { class: "axis", d: `M${left} 6V${height - bottom}H${width - 6}` }),
        svg("text", { x: 2, y: 12, "font-size": 10 }, `${number(most, 0)} m`),
        svg("text", { x: width - 6, y: height - 4, "font-size": 10, "text-anchor": "end" }, `step ${this.length - 1}`));
      for (const [k, agent] of this.agents.entries()) {
        if (!this.shown.has(agent)) continue;
        const points = this.walks[agent].distance
          .map((value, step) => (value === null ? "" : `${x(step).toFixed(1)},${y(value).toFixed(1)}`)).filter(Boolean);
        node.append(svg("polyline", { points: points.join(" "), class: `way walk agent-${k % 4}` }));
        const every = Math.max(1, Math.round(points.length / 6));
        for (let at = Math.floor(every / 2); at < points.length; at += every) {
          node.append(explorer.bead(...points[at].split(",").map(Number), `agent-${k % 4}`, explorer.SHAPES[k % 4]));
        }
      }
      node.append(svg("path", { class: "now", d: `M${x(this.step)} 6V${height - bottom}` }));
      this.chart.replaceChildren(node);
    }
  }

  function heading(walk, at) {
    if (walk.headings) return walk.headings[at];
    for (let k = at; k > 0; k -= 1) {
      const east = walk.path[k][0] - walk.path[k - 1][0];
      const north = walk.path[k - 1][2] - walk.path[k][2];
      if (east || north) return (Math.atan2(east, north) * 180) / Math.PI;
    }
    return 0;
  }

  explorer.Playback = Playback;
}
