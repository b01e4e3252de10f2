"use strict";
// The live page: asks for what is new a few times a second, keeps what the window shows, draws it.
const EVERY_MS = 250;
const WINDOWS = [["1 min", 60], ["10 min", 600], ["1 h", 3600], ["8 h", 28800], ["24 h", 86400]];
const COUNTS = [
  ["samples", "samples"], ["published", "estimates"], ["lost", "samples lost"], ["bad_frames", "damaged frames"],
  ["reconnects", "line opened again"], ["missed", "rows this page missed"],
];
const $ = id => document.getElementById(id);
const cards = [];
let about, shown = {level: -1, after: 0, time: [], values: [], sigma: [], doubt: []};
let windowS = 60, held = false, before = null, pointer = null, last = null;

start();

async function start() {
  history.replaceState(null, "", location.pathname); // the key need not stand in the address line
  WINDOWS.forEach(([name, seconds], k) => {
    const button = make("button", name, $("windows"));
    button.type = "button";
    button.onclick = () => choose(seconds);
    button.dataset.seconds = seconds;
  });
  const hold = make("button", "Hold", $("windows"));
  hold.type = "button";
  hold.id = "hold";
  hold.onclick = toggle;
  choose(60);
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const window_ = WINDOWS[Number(event.key) - 1];
    if (event.key !== " " && window_) choose(window_[1]);
    else if (event.key === " " && event.target === document.body) { event.preventDefault(); toggle(); }
  });
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  for (;;) {
    try {
      if (!about) await introduce();
      let live, asked;
      do {
        asked = windowS;
        live = await ask(`/live?window=${asked}&level=${shown.level}&after=${shown.after}`);
        if (asked === windowS) take(live); // else it answers a question that nobody asks any more
      } while (live.more || asked !== windowS);
      tell(live);
      if (!held) draw();
    } catch (error) {
      gone(error.message);
    }
    await new Promise(done => setTimeout(done, document.hidden ? 2000 : EVERY_MS));
  }
}

async function ask(path) {
  const reply = await fetch(path);
  if (!reply.ok) throw new Error((await reply.text()).trim());
  return reply.json();
}

async function introduce() {
  about = await ask("/about");
  $("about").textContent = `motorlens monitor: ${about.sensor} ${about.version}`;
  about.outputs.forEach((output, k) => {
    const card = make("section", "", $("quantities"));
    card.className = "quantity";
    const words = make("div", "", card);
    make("h2", output.name + (output.heading === "temperature_rise_K" ? " above ambient" : ""), words);
    const value = make("p", "", words), spread = make("p", "", words), also = make("p", "", words);
    value.className = "value";
    spread.className = also.className = "spread";
    const canvas = make("canvas", "", make("div", "", card));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${output.name} in ${output.unit} over time, with two standard deviations`);
    canvas.onpointermove = event => { pointer = event.offsetX / canvas.clientWidth; draw(); };
    canvas.onpointerleave = () => { pointer = null; draw(); };
    cards.push({output, card, value, spread, also, canvas});
  });
}

function take(live) {
  last = live;
  const same = live.level === shown.level && live.first === shown.after;
  if (!same) shown = {time: [], values: live.values.map(() => []), sigma: live.values.map(() => []), doubt: []};
  shown.level = live.level;
  shown.after = live.after;
  append(shown.time, live.time_s);
  append(shown.doubt, live.doubt);
  live.values.forEach((row, k) => append(shown.values[k], row));
  live.sigma.forEach((row, k) => append(shown.sigma[k], row));
  const newest = live.latest ? live.latest.time_s : 0;
  let old = 0;
  while (old < shown.time.length && shown.time[old] < newest - windowS) old++;
  if (old) for (const row of [shown.time, shown.doubt, ...shown.values, ...shown.sigma]) row.splice(0, old);
  if (live.counts.device) $("about").textContent = `motorlens monitor: ${about.sensor} ${about.version} on ${live.counts.device}`;
}

function append(row, more) {
  for (const value of more) row.push(value);
}

function tell(live) {
  const latest = live.latest;
  if (latest) {
    const words = latest.reasons.map(reason => about.reasons[reason] || reason).join("; ");
    const silent = latest.age_s > 3 ? `Nothing has come for ${duration(Math.round(latest.age_s))}` : "";
    const status = {good: "Good", uncertain: "Uncertain", bad: "Bad"}[latest.status] + (words ? `: ${words}` : "");
    state(silent ? "gone" : latest.status, silent || status);
    cards.forEach(({output, card, value, spread, also}, k) => {
      card.classList.toggle("old", latest.reasons.includes("stale") || latest.age_s > 3);
      put(value, number(latest.values[k], latest.sigma[k]));
      make("small", " " + unit(output.unit), value);
      put(spread, `± ${number(2 * latest.sigma[k], latest.sigma[k])} ${unit(output.unit)} (2σ)`);
      if (output.unit === "rad/s") put(also, `${number(latest.values[k] * 30 / Math.PI, latest.sigma[k] * 10)} rpm`);
    });
  } else state("", "Waiting for the first estimate");
  fill($("alarms"), live.alarms.map(alarm => `Alarm: ${alarm.alarm}: ${alarm.message}`));
  const events = live.events.slice().reverse();
  $("no-events").hidden = events.length > 0;
  if (events.length !== $("events").childElementCount || events.length === 100) {
    $("events").replaceChildren(...events.map(event => {
      const item = document.createElement("li");
      if (event.timestamp !== undefined) make("time", `${event.timestamp.toFixed(1)} s`, item);
      const on = event.event === "alarm" ? `${event.active ? "on" : "off"}: ${event.alarm}: ` : "";
      item.append(on + event.message);
      return item;
    }));
  }
  count(live);
}

function count(live) {
  const now = performance.now() / 1000;
  const counts = {published: live.rows, ...live.counts};
  if (!before || now - before.at > 2) {
    const rates = {};
    if (before) for (const name of ["samples", "published"])
      if (name in counts && name in before.counts) rates[name] = (counts[name] - before.counts[name]) / (now - before.at);
    before = {at: now, counts, rates: before ? rates : {}};
  }
  const rows = COUNTS.filter(([name]) => name in counts).map(([name, words]) => {
    const rate = before.rates[name];
    return [words, counts[name].toLocaleString("en"), rate === undefined ? "" : `${rate < 10 ? rate.toFixed(1) : Math.round(rate)} a second`];
  });
  for (const [alarm, left] of Object.entries(counts.time_to_limit_s || {}))
    rows.push([`time to the limit: ${alarm}`, left === null ? "not in sight" : duration(left), ""]);
  $("counts").replaceChildren(...rows.map(row => {
    const line = document.createElement("tr");
    row.forEach(cell => make("td", cell, line));
    return line;
  }));
}

function gone(why) {
  state("gone", `No answer from the runtime${why && !why.includes("fetch") ? ": " + why : ""}`);
  cards.forEach(({card}) => card.classList.add("old"));
}

function state(kind, words) {
  $("status").className = `verdict ${kind}`;
  put($("status"), words);
  document.title = words;
}

function draw() {
  const style = getComputedStyle(document.documentElement), colour = name => style.getPropertyValue(`--${name}`).trim();
  const end = last && last.latest ? last.latest.time_s : 0, begin = end - windowS;
  cards.forEach(({output, canvas}, k) => {
    const scale = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * scale;
    canvas.height = height * scale;
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    pen.font = "12px system-ui, sans-serif";
    const {time, doubt} = shown, y = shown.values[k] || [], s = shown.sigma[k] || [];
    const plot = {left: 56, right: width - 8, top: 6, bottom: height - 24};
    let low = Infinity, high = -Infinity;
    y.forEach((v, j) => {
      if (v === null) return;
      const spread = s[j] === null ? 0 : 2 * s[j];
      low = Math.min(low, v - spread);
      high = Math.max(high, v + spread);
    });
    if (low > high) [low, high] = [0, 1];
    const least = Math.max(Math.abs(high), Math.abs(low)) * 1e-4 || 1;
    const margin = Math.max((high - low) * 0.08, least);
    low -= margin;
    high += margin;
    const px = t => plot.left + (t - begin) / windowS * (plot.right - plot.left);
    const py = v => plot.bottom - (v - low) / (high - low) * (plot.bottom - plot.top);
    pen.textBaseline = "middle";
    for (const tick of ticks(low, high, 5)) {
      pen.fillStyle = colour("faint");
      pen.fillRect(plot.left, Math.round(py(tick)), plot.right - plot.left, 1);
      pen.fillStyle = colour("faded");
      pen.textAlign = "right";
      pen.fillText(tickText(tick, high - low), plot.left - 6, py(tick));
    }
    pen.textAlign = "center";
    for (let j = 0; j <= 6; j++) {
      const t = begin + windowS * j / 6;
      pen.textAlign = j === 0 ? "left" : j === 6 ? "right" : "center";
      pen.fillText(j === 6 ? "now" : `-${duration(windowS * (6 - j) / 6)}`, px(t), height - 8);
    }
    const step = time.length > 1 ? (time[time.length - 1] - time[0]) / (time.length - 1) : 1;
    const whole = [];
    let piece = [];
    y.forEach((v, j) => {
      if (piece.length && (v === null || time[j] - time[j - 1] > Math.max(5 * step, 0.5))) { whole.push(piece); piece = []; }
      if (v !== null) piece.push(j);
    });
    if (piece.length) whole.push(piece);
    pen.save();
    pen.beginPath();
    pen.rect(plot.left, 0, plot.right - plot.left, height);
    pen.clip();
    for (const part of whole) {
      pen.beginPath();
      part.forEach(j => pen.lineTo(px(time[j]), py(y[j] + 2 * (s[j] || 0))));
      part.slice().reverse().forEach(j => pen.lineTo(px(time[j]), py(y[j] - 2 * (s[j] || 0))));
      pen.fillStyle = colour("predicted");
      pen.globalAlpha = 0.22;
      pen.fill();
      pen.globalAlpha = 1;
      pen.beginPath();
      part.forEach(j => pen.lineTo(px(time[j]), py(y[j])));
      pen.strokeStyle = colour("predicted");
      pen.lineWidth = 1.6;
      pen.stroke();
    }
    doubt.forEach((code, j) => {
      if (!code) return;
      pen.fillStyle = colour(code === 2 ? "bad" : "doubt");
      const from = px(time[j]), to = j + 1 < time.length ? px(time[j + 1]) : from + 2;
      pen.fillRect(from, plot.bottom, Math.max(to - from, 1) + 0.5, 4);
    });
    pen.restore();
    if (pointer !== null && time.length) point(pen, pointer * width, plot, time, y, s, px, py, end, output, colour);
  });
}

function point(pen, x, plot, time, y, s, px, py, end, output, colour) {
  let nearest = 0;
  time.forEach((t, j) => { if (Math.abs(px(t) - x) < Math.abs(px(time[nearest]) - x)) nearest = j; });
  if (y[nearest] === null || y[nearest] === undefined) return;
  const at = px(time[nearest]);
  pen.fillStyle = colour("faded");
  pen.fillRect(at, plot.top, 1, plot.bottom - plot.top);
  const text = `${number(y[nearest], s[nearest])} ± ${number(2 * s[nearest], s[nearest])} ${unit(output.unit)}, ${duration(end - time[nearest])} ago`;
  const right = at > (plot.left + plot.right) / 2;
  const width = pen.measureText(text).width;
  pen.fillStyle = colour("panel");
  pen.fillRect(right ? at - width - 14 : at + 4, plot.top, width + 10, 20);
  pen.fillStyle = colour("ink");
  pen.textAlign = right ? "right" : "left";
  pen.fillText(text, at + (right ? -9 : 9), plot.top + 10);
}

function ticks(low, high, about_) {
  const raw = (high - low) / about_, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map(m => m * power).find(m => m >= raw);
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) found.push(v);
  return found;
}

function tickText(value, span) {
  const digits = Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(span / 4))));
  return Number(value.toFixed(digits)).toLocaleString("en", {maximumFractionDigits: digits});
}

// As many digits as two standard deviations leave meaning to, and one more.
function number(value, sd) {
  if (value === null || value === undefined || Number.isNaN(value)) return "-";
  const digits = sd > 0 && isFinite(sd) ? Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(2 * sd)))) : 3;
  return value.toFixed(digits).replace(/^-0(\.0*)?$/, "0$1");
}

function unit(text) {
  return {ohm: "Ω", degC: "°C"}[text] || text;
}

function duration(seconds) {
  if (seconds < 100) return `${seconds < 10 ? Number(seconds.toFixed(1)) : Math.round(seconds)} s`;
  if (seconds < 6000) return `${Number((seconds / 60).toFixed(1))} min`;
  return `${Number((seconds / 3600).toFixed(1))} h`;
}

function choose(seconds) {
  windowS = seconds;
  shown = {level: -1, after: 0, time: [], values: [], sigma: [], doubt: []};
  for (const button of $("windows").querySelectorAll("[data-seconds]"))
    button.setAttribute("aria-pressed", Number(button.dataset.seconds) === seconds);
}

function toggle() {
  held = !held;
  $("hold").setAttribute("aria-pressed", held);
  if (!held) draw();
}

function make(tag, text, parent) {
  const element = document.createElement(tag);
  element.textContent = text;
  parent.append(element);
  return element;
}

function put(element, text) {
  element.textContent = text;
}

function fill(list, texts) {
  if (texts.join("\n") === [...list.children].map(item => item.textContent).join("\n")) return;
  list.replaceChildren();
  texts.forEach(text => make("li", text, list));
}
