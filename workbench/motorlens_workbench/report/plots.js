"use strict";
// Plots of a report, in the page of a report and in that of the workbench. All samples are here; uPlot thins them to the
// pixels of the view. Plots of one recording share their time axis and their cursor; what is chosen by a button with
// `data-samples` is marked in all of them.

let palette = {};

// A colour of the style sheet as it is now: light, dark, or the reader's own in high contrast.
function colour(name) {
  if (!palette[name]) {
    const probe = document.createElement("span");
    probe.className = "probe";
    probe.style.color = `var(--${name})`;
    document.body.append(probe);
    palette[name] = getComputedStyle(probe).color;
    probe.remove();
  }
  return palette[name];
}

function floats(text, kind) {
  const octets = Uint8Array.fromBase64 ? Uint8Array.fromBase64(text) : Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return new kind(octets.buffer);
}

function short(value, digits = 6) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Math.abs(value) >= 1e6 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(3) : String(Number(value.toPrecision(digits)));
}

function unitOf(text) {
  return {degC: "°C", 1: ""}[text] ?? text.replaceAll("*", " ");
}

function put(tag, parent, text, classes) {
  const element = document.createElement(tag);
  if (text !== undefined && text !== null) element.textContent = text;
  if (classes) element.className = classes;
  if (parent) parent.append(element);
  return element;
}

function press(parent, text, label, act) {
  const button = put("button", parent, text);
  button.type = "button";
  button.title = label;
  button.setAttribute("aria-label", label);
  button.onclick = act;
  return button;
}

// What all plots have in common.
function axes(x, y) {
  const style = {stroke: () => colour("faded"), grid: {stroke: () => colour("faint"), width: 1}, ticks: {stroke: () => colour("line"), width: 1}, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif"};
  const tick = (u, values) => values.map(value => value === null ? "" : short(value));
  [x, y] = [x, y].map(label => label.replace("N*m", "N m").replace("degC", "°C"));
  return [{...style, label: x, labelSize: x ? 20 : 0, size: 30, values: tick}, {...style, label: y, labelSize: 20, size: 62, space: 22, values: tick}];
}

// All pictures of one report. `source` holds its data: this document, or one that was fetched.
class Scene {
  constructor(root, source, actions = {}) {
    this.root = root;
    this.source = source;
    this.actions = actions; // range(name, from, to): what else can be done with the stretch in view
    this.groups = [];
    this.plots = [];
    this.clouds = [];
    const described = JSON.parse(source.getElementById("pictures").textContent);
    const places = [...root.querySelectorAll("[data-picture]")].map(place => [place, described[Number(place.dataset.picture)]]);
    for (const [place, spec] of places) if (spec.kind === "time") this.groups.push(new TimePlots(this, place, spec, `${spec.name}-${this.groups.length}-${Math.random()}`));
    for (const [place, spec] of places) if (spec.kind === "curves") drawCurves(this, place, spec);
    for (const [place, spec] of places) if (spec.kind === "cloud") drawCloud(this, place, spec);
    this.marked = new Marked(this);
    root.addEventListener("click", event => {
      const button = event.target.closest("button.samples");
      if (button && root.contains(button)) this.mark(JSON.parse(button.dataset.samples), button);
    });
    // A report is not drawn for the screen it is printed on, nor for the light it was opened in.
    this.redraw = () => { palette = {}; this.plots.forEach(plot => plot.redraw(false, true)); };
    this.queries = ["(prefers-color-scheme: dark)", "(forced-colors: active)"].map(query => matchMedia(query));
    this.queries.forEach(query => query.addEventListener("change", this.redraw));
    this.size = new ResizeObserver(() => this.fit());
    places.forEach(([place]) => this.size.observe(place));
  }

  close() {
    for (const query of this.queries) query.removeEventListener("change", this.redraw);
    this.size.disconnect();
    this.plots.forEach(plot => plot.destroy());
  }

  fit() {
    for (const plot of this.plots) {
      const width = plot.root.parentElement.clientWidth;
      if (width > 50 && width !== plot.width) plot.setSize({width, height: plot.asked});
    }
  }

  add(options, data, parent) {
    const plot = new uPlot({width: Math.max(parent.clientWidth, 200), ...options}, data, parent);
    plot.asked = options.height;
    this.plots.push(plot);
    return plot;
  }

  mark(what, button) {
    if (!this.groups.length) return;
    this.root.querySelectorAll("button.samples[aria-pressed=true]").forEach(other => other.removeAttribute("aria-pressed"));
    if (button) button.setAttribute("aria-pressed", "true");
    // The tenth at which an equation lacks most is taken over all recordings.
    let least = Infinity;
    if (what.lacks) {
      const all = this.groups.flatMap(group => group.lacks(what.lacks) ? [...everyNth(group.lacks(what.lacks), 100000)] : []).map(Math.abs).sort((a, b) => a - b);
      least = all.length ? all[Math.floor(0.9 * all.length)] : Infinity;
    }
    for (const group of this.groups) group.mark(what, least);
    this.marked.show(what.label);
  }

  clear() {
    this.root.querySelectorAll("button.samples[aria-pressed=true]").forEach(other => other.removeAttribute("aria-pressed"));
    this.groups.forEach(group => group.unmark());
  }
}

function everyNth(values, most) {
  const step = Math.max(1, Math.ceil(values.length / most));
  return step === 1 ? values : values.filter((value, k) => k % step === 0);
}

// What is marked, and the way from one stretch of it to the next.
class Marked {
  constructor(scene) {
    this.scene = scene;
    this.bar = put("div", null, null, "marked");
    this.bar.hidden = true;
    scene.root.prepend(this.bar);
    this.text = put("span", this.bar);
    this.text.setAttribute("role", "status");
    this.next = press(this.bar, "Next stretch", "Zoom to the next stretch of these samples", () => this.step(1));
    press(this.bar, "Previous", "Zoom to the previous stretch of these samples", () => this.step(-1));
    press(this.bar, "Clear", "Mark no samples", () => { scene.clear(); this.bar.hidden = true; });
  }

  show(label) {
    this.stretches = this.scene.groups.flatMap(group => group.stretches.map(span => ({group, span})));
    this.label = label;
    this.at = -1;
    this.bar.hidden = false;
    const samples = this.scene.groups.reduce((sum, group) => sum + group.marked, 0);
    const many = this.stretches.length;
    this.text.textContent = `${label}: ${samples} samples in ${many} stretch${many === 1 ? "" : "es"}`;
    if (!many) return;
    const longest = this.stretches.reduce((best, {span}, k) => span[1] - span[0] > this.length(best) ? k : best, 0);
    this.stretches[longest].group.box.scrollIntoView({block: "start", behavior: "instant"});
    this.at = longest - 1;
    this.next.focus({preventScroll: true});
  }

  length(k) {
    return this.stretches[k].span[1] - this.stretches[k].span[0];
  }

  step(by) {
    if (!this.stretches.length) return;
    this.at = (this.at + by + this.stretches.length) % this.stretches.length;
    const {group, span} = this.stretches[this.at];
    const [from, to] = span.map(k => group.time[k]), wide = Math.max(to - from, 20 * (group.time[1] - group.time[0]));
    group.view(from - wide / 2, to + wide / 2);
    group.box.scrollIntoView({block: "nearest", behavior: "instant"});
    this.text.textContent = `${this.label}: stretch ${this.at + 1} of ${this.stretches.length}, ${short(from)} to ${short(to)} s`;
  }
}
