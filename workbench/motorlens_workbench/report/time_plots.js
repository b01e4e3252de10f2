"use strict";
// Plots of one recording over each other: one time axis, one cursor, and the samples that are marked. See `plots.js`.

const MERGE = 0.002; // stretches of samples closer than this share of a recording are one

class TimePlots {
  constructor(scene, place, spec, key) {
    Object.assign(this, {scene, spec, key, box: place, columns: {}, stretches: [], spans: [], marked: 0, plots: []});
    const t = spec.time;
    this.time = t.data ? floats(this.text(t.data), Float64Array) : Float64Array.from({length: t.count}, (_, k) => t.start + k * t.step);
    place.classList.add("time");
    place.setAttribute("role", "group");
    place.setAttribute("aria-label", `${spec.name} against time; arrow keys move, plus and minus zoom, 0 shows all, Shift with an arrow moves the cursor`);
    place.tabIndex = 0;
    place.onkeydown = event => this.key_(event);
    this.tools();
    spec.plots.forEach((plot, k) => this.draw(plot, k === spec.plots.length - 1));
    place.addEventListener("wheel", event => {
      if (!event.ctrlKey && !event.shiftKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      const u = this.plots[0], at = u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x");
      this.zoom((event.deltaY || event.deltaX) > 0 ? 1.4 : 1 / 1.4, at);
    }, {passive: false});
  }

  text(name) {
    return this.scene.source.getElementById(this.spec.data[name]).textContent;
  }

  column(name) {
    return this.columns[name] ??= floats(this.text(name), Float32Array);
  }

  state(name) {
    return name === "time" ? this.time : this.spec.states[name] && this.column(this.spec.states[name]);
  }

  lacks(equation) {
    return this.spec.lacks[equation] && this.column(this.spec.lacks[equation]);
  }

  values(line) {
    const from = this.column(line.data);
    let found = from;
    if (line.less) {
      const less = this.column(line.less);
      found = from.map((value, k) => value - less[k]);
    }
    return found.some(Number.isNaN) ? Array.from(found, value => Number.isNaN(value) ? null : value) : found;
  }

  tools() {
    const bar = put("div", this.box, null, "tools");
    press(bar, "All", "Show the whole recording", () => this.all());
    press(bar, "+", "Zoom in", () => this.zoom(0.5));
    press(bar, "−", "Zoom out", () => this.zoom(2));
    press(bar, "◀", "Earlier", () => this.move(-0.5));
    press(bar, "▶", "Later", () => this.move(0.5));
    this.limits = ["from", "to"].map(word => {
      const label = put("label", bar, `${word} `);
      const input = put("input", label);
      Object.assign(input, {type: "text", inputMode: "decimal", size: 9, autocomplete: "off"});
      input.setAttribute("aria-label", `${word}, in seconds, of what is shown of ${this.spec.name}`);
      input.onchange = () => this.view(...this.limits.map(box => Number(box.value.replace(",", "."))));
      return input;
    });
    put("span", bar, "s");
    press(bar, "Save CSV", "Save the samples in view as CSV", () => this.save());
    if (this.scene.actions.range) press(bar, "Work on this range", "Use only this range of the recording in the next steps", () => this.scene.actions.range(this.spec.name, ...this.shown()));
  }

  draw(spec, last) {
    // High contrast has too few colours to tell lines by: what is off, or was before, is dashed.
    const dashed = matchMedia("(forced-colors: active)").matches ? [7, 4] : undefined;
    const unit = unitOf(spec.unit), value = (u, v) => v === null || v === undefined ? "–" : `${short(v)}${unit ? " " + unit : ""}`;
    const series = spec.lines.map(line => ({label: line.name, stroke: () => colour(line.role), dash: line.role === "lacking" ? dashed : undefined, width: 1.3, value, points: {size: 4}}));
    const data = [this.time, ...spec.lines.map(line => this.values(line))];
    const u = this.scene.add({
      height: (spec.height || 190) + (last ? 20 : 0), axes: axes(last ? "time, s" : "", spec.title.endsWith(" error") ? `error, ${unit}` : `${spec.title}, ${unit}`),
      scales: {x: {time: false}, y: {range: (_, low, high) => rangeOf(low, high)}},
      series: [{label: "time", value: (_, v) => v === null || v === undefined ? "–" : `${short(v, 9)} s`}, ...series],
      cursor: {sync: {key: this.key, setSeries: false}, drag: {x: true, y: false}, points: {size: 6}},
      legend: {live: true},
      hooks: {drawClear: [plot => this.back(plot, spec.band)], setScale: [(plot, scale) => { if (scale === "x") this.follow(plot); }]},
    }, data, this.box);
    const ends = line => { const [low, high] = extremes(line); return `${short(low, 4)} to ${short(high, 4)} ${unit}`; };
    const wrap = u.root.querySelector(".u-wrap");
    wrap.setAttribute("role", "img");
    wrap.setAttribute("aria-label", `${spec.title} against time: ${spec.lines.map((line, k) => `${line.name} ${ends(data[k + 1])}`).join("; ")}`);
    this.plots.push(u);
    this.follow(u);
  }

  // Behind the lines: the noise floor, and the samples that are marked.
  back(u, band) {
    const {ctx, bbox} = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    if (band > 0) {
      const high = u.valToPos(band, "y", true), low = u.valToPos(-band, "y", true);
      ctx.globalAlpha = 0.3;
      ctx.fillStyle = colour("noise");
      ctx.fillRect(bbox.left, high, bbox.width, low - high);
    }
    ctx.globalAlpha = 0.28;
    ctx.fillStyle = colour("marked");
    const {min, max} = u.scales.x;
    let left = null, right = null;
    const fill = () => { if (left !== null) ctx.fillRect(left, bbox.top, Math.max(right - left, 1.5), bbox.height); };
    for (const [a, b] of this.spans) {
      if (this.time[b] < min || this.time[a] > max) continue;
      const from = u.valToPos(this.time[a], "x", true), to = u.valToPos(this.time[b], "x", true);
      if (left !== null && from <= right + 1) right = Math.max(right, to);
      else { fill(); left = from; right = to; }
    }
    fill();
    ctx.restore();
  }

  // Marks samples; if none of them is in view, all of the recording is shown.
  mark(what, least) {
    const test = [];
    for (const [name, [low, high]] of Object.entries(what.within)) {
      const values = this.state(name), slack = 1e-6 * Math.max(Math.abs(low), Math.abs(high)); // float32 at the border
      if (values) test.push(k => values[k] >= low - slack && values[k] <= high + slack);
    }
    if (what.recording && what.recording !== this.spec.name) test.push(() => false);
    const lacking = what.lacks && this.lacks(what.lacks);
    if (what.lacks) test.push(lacking ? k => Math.abs(lacking[k]) >= least : () => false);
    this.spans = [];
    this.marked = 0;
    for (let k = 0; k < this.time.length; k++) {
      if (!test.every(holds => holds(k))) continue;
      this.marked++;
      const open = this.spans.at(-1);
      if (open && open[1] === k - 1) open[1] = k;
      else this.spans.push([k, k]);
    }
    const near = MERGE * this.time.length;
    this.stretches = [];
    for (const [a, b] of this.spans) {
      const open = this.stretches.at(-1);
      if (open && a - open[1] <= near) open[1] = b;
      else this.stretches.push([a, b]);
    }
    const [from, to] = this.shown();
    if (!this.spans.some(([a, b]) => this.time[b] >= from && this.time[a] <= to)) this.all();
    this.plots.forEach(plot => plot.redraw(false, false));
  }

  unmark() {
    this.spans = this.stretches = [];
    this.marked = 0;
    this.plots.forEach(plot => plot.redraw(false, false));
  }

  shown() {
    const {min, max} = this.plots[0].scales.x;
    return [min, max];
  }

  // All plots show the same stretch of time.
  follow(from) {
    const {min, max} = from.scales.x;
    if (min === null || min === undefined) return;
    this.plots.forEach(plot => { if (plot !== from && (plot.scales.x.min !== min || plot.scales.x.max !== max)) plot.setScale("x", {min, max}); });
    this.limits[0].value = short(min, 7);
    this.limits[1].value = short(max, 7);
  }

  view(from, to) {
    const first = this.time[0], last = this.time.at(-1);
    if (!(to > from)) return this.follow(this.plots[0]);
    const wide = Math.min(Math.max(to - from, 2 * (last - first) / this.time.length), last - first);
    const start = Math.min(Math.max(from, first), last - wide);
    this.plots[0].setScale("x", {min: start, max: start + wide});
  }

  all() {
    this.view(this.time[0], this.time.at(-1));
  }

  zoom(factor, at) {
    const [from, to] = this.shown(), still = at ?? (from + to) / 2;
    this.view(still - factor * (still - from), still + factor * (to - still));
  }

  move(share) {
    const [from, to] = this.shown(), by = share * (to - from);
    this.view(from + by, to + by);
  }

  key_(event) {
    if (event.target !== this.box || event.ctrlKey || event.altKey || event.metaKey) return;
    const act = {ArrowLeft: () => this.move(-0.2), ArrowRight: () => this.move(0.2), "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), 0: () => this.all(), Home: () => this.all()};
    const step = event.shiftKey && {ArrowLeft: -1, ArrowRight: 1}[event.key];
    if (!step && !act[event.key]) return;
    event.preventDefault();
    event.stopPropagation();
    if (step) this.point(step);
    else act[event.key]();
  }

  // The cursor one sample further; the numbers are in the legends.
  point(step) {
    const u = this.plots[0], [from, to] = this.shown();
    let k = u.cursor.idx ?? this.time.findIndex(t => t >= (from + to) / 2);
    k = Math.min(Math.max(k + step, 0), this.time.length - 1);
    this.plots.forEach(plot => plot.setCursor({left: plot.valToPos(this.time[k], "x"), top: 10}, false));
  }

  save() {
    const [from, to] = this.shown(), names = Object.keys(this.spec.data).filter(name => name !== "time_s"), rows = [];
    rows.push(["time_s", ...names.map(name => name.replaceAll(/[^A-Za-z0-9]+/g, "_"))].join(","));
    for (let k = 0; k < this.time.length; k++)
      if (this.time[k] >= from && this.time[k] <= to)
        rows.push([Number(this.time[k].toPrecision(10)), ...names.map(name => Number.isNaN(this.column(name)[k]) ? "" : Number(this.column(name)[k].toPrecision(8)))].join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([rows.join("\n") + "\n"], {type: "text/csv"}));
    link.download = `${this.spec.name.replace(/\.\w+$/, "").replaceAll(/[^\w.-]+/g, "_")}_${short(from, 5)}-${short(to, 5)}s.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}

function rangeOf(low, high) {
  if (low === null || low === undefined) return [0, 1];
  const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
  return [low - room, high + room];
}

function extremes(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) if (value !== null) { if (value < low) low = value; if (value > high) high = value; }
  return [low, high];
}
