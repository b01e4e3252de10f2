"use strict";
// The live page: asks for what is new a few times a second, keeps what the window shows, draws it.
const EVERY_MS = 250;
const WINDOWS = [["1 min", 60], ["10 min", 600], ["1 h", 3600], ["8 h", 28800], ["24 h", 86400]];
const COUNTS = [
  ["samples", "samples"], ["published", "estimates"], ["lost", "samples lost"], ["bad_frames", "damaged frames"],
  ["reconnects", "line opened again"], ["missed", "rows this page missed"],
];
// A runtime repeats its last estimate ten times a second when its own line is silent: one that says nothing is gone.
const SILENT_S = 3;
const $ = id => document.getElementById(id);
const seen = {limits: []};
let about, cards = [], motor = 0, motors = [], rpm = false;
let shown = nothing(), complete = false, windowS = 60, last = null, before = null;
// What is drawn instead of what comes: `held` a picture of one moment, `player` a recording.
let held = null, wantsHold = false, player = null;

start();

function nothing() {
  return {level: -1, after: 0, time: [], values: [], sigma: [], doubt: []};
}

async function start() {
  history.replaceState(null, "", location.pathname); // the key need not stand in the address line
  rpm = localStorage.getItem("rpm") === "true";
  controls();
  choose(60);
  for (;;) {
    try {
      if (!about) await introduce();
      if (about) await news();
    } catch (error) {
      gone(error.message);
    }
    await new Promise(done => setTimeout(done, document.hidden ? 2000 : EVERY_MS));
  }
}

async function news() {
  let live;
  do {
    const asked = shown;
    live = await ask(`/live?motor=${motor}&window=${windowS}&level=${asked.level}&after=${asked.after}`);
    // Whoever chooses meanwhile, be it the same window, begins anew: what came goes on from rows that are no longer there.
    if (asked !== shown) return;
    take(live);
  } while (live.more);
  tell(live);
  complete = shown.time.length > 0;
  if (wantsHold) hold();
  if (!held && !player) draw();
  if (motors.length > 1) overview((await ask("/motors")).motors);
}

async function ask(path, document_) {
  const reply = await fetch(path, document_ && {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(document_)});
  if (!reply.ok) throw new Error((await reply.text()).trim());
  return reply.json();
}

async function introduce() {
  const of = motor, found = await ask(`/about?motor=${of}`);
  motors = (await ask("/motors")).motors;
  if (of !== motor) return;
  about = found;
  put($("about"), `motorlens monitor: ${about.sensor} ${about.version}`);
  $("quantities").replaceChildren();
  cards = about.outputs.map(output => card(output));
  $("quantity").replaceChildren();
  about.outputs.filter(o => !o.input).forEach(o => make("option", title(o), $("quantity")).value = o.heading);
  units();
}

function title(output) {
  return output.name + (output.heading === "temperature_rise_K" ? " above ambient" : "");
}

function card(output) {
  const place = make("section", "", $("quantities"), output.input ? "quantity input" : "quantity");
  place.hidden = Boolean(output.input); // until a voltage or a current comes
  const words = make("div", "", place);
  make("h2", title(output), words);
  const value = make("p", "", words, "value"), figure = make("span", "", value), small = make("small", "", value);
  const spread = make("p", "", words, "spread"), also = make("p", "", words, "spread"), at = make("p", "", words, "spread");
  const area = make("div", "", place, "plot");
  area.setAttribute("role", "img");
  area.setAttribute("aria-label", `${title(output)} in ${output.unit} over time${output.input ? "" : ", with two standard deviations"}`);
  const plot = new Plot(area, output, seen, zoom, pointed);
  return {output, place, figure, small, spread, also, at, plot};
}

function take(live) {
  last = live;
  // A stream that begins again has another time of day for its zero; what was before is not drawn over it.
  const same = live.level === shown.level && live.first === shown.after && live.offset_s === shown.offset;
  if (!same) shown = {...nothing(), values: live.values.map(() => []), sigma: live.values.map(() => [])};
  shown.level = live.level;
  shown.after = live.after;
  shown.offset = live.offset_s;
  append(shown.time, live.time_s.map(t => t + live.offset_s));
  append(shown.doubt, live.doubt);
  live.values.forEach((row, k) => append(shown.values[k], row));
  live.sigma.forEach((row, k) => append(shown.sigma[k], row));
  const newest = end();
  let old = 0;
  while (old < shown.time.length && shown.time[old] < newest - windowS) old++;
  if (old) for (const row of [shown.time, shown.doubt, ...shown.values, ...shown.sigma]) row.splice(0, old);
  if (live.counts.device) put($("about"), `motorlens monitor: ${about.sensor} ${about.version} on ${live.counts.device}`);
}

function append(row, more) {
  for (const value of more) row.push(value);
}

function end() {
  return last && last.latest ? last.latest.time_s + last.offset_s : Date.now() / 1000;
}

function tell(live) {
  const latest = live.latest, silent = latest && latest.age_s > SILENT_S;
  const dead = silent || (latest && latest.reasons.includes("line_lost"));
  if (latest) {
    const words = latest.reasons.toReversed().filter(reason => !dead || reason !== "stale").map(reason => about.reasons[reason] || reason).join("; ");
    const word = {good: "Good", uncertain: "Uncertain", bad: "Bad"}[latest.status] + (words ? `: ${words}` : "");
    state(silent ? "bad" : latest.status, silent ? "Bad: nothing comes from the runtime" : word);
    const since = live.latest.fresh_at === null ? 0 : Date.now() / 1000 - latest.fresh_at;
    put($("dated"), since > SILENT_S ? `Last values of ${clock(latest.fresh_at)}, ${duration(Math.round(since))} ago` : "");
    if (!player) values(latest.values, latest.sigma, dead || latest.reasons.includes("stale"), latest.status === "bad" || dead);
  } else state("", "Waiting for the first estimate");
  seen.limits = live.limits;
  fill($("alarms"), "p", live.alarms.map(alarm => alarmWords(alarm, latest, dead)));
  const events = live.events.slice().reverse();
  $("no-events").hidden = events.length > 0;
  fill($("events"), "li", events.map(event => {
    const on = event.event === "alarm" ? `alarm ${event.active ? "on" : "off"}: ${event.alarm}: ` : "";
    return `${clock(event.at)}  ${on}${event.message}`;
  }));
  count(live, dead);
  limits(live.limits);
  const recording = live.recording;
  $("record").setAttribute("aria-pressed", recording.on);
  put($("record"), recording.on ? `Stop recording (${recording.rows} rows)` : "Record");
  $("recording").hidden = recording.on || !recording.there;
  $("recording").href = `/recording.csv?motor=${motor}`;
}

// Since when, and what the value is now: the message of the event was true when it went on.
function alarmWords(alarm, latest, dead) {
  const limit = seen.limits.find(one => one.name === alarm.alarm), card = limit && cards[limit.column];
  const now = card && latest && !dead ? `, now ${number(latest.values[limit.column] * factor(card.output), latest.sigma[limit.column] * factor(card.output))} ${unit(card.output)}` : "";
  const bound = card ? ` (limit ${figures(limit.limit * factor(card.output))} ${unit(card.output)})` : "";
  return `Alarm since ${clock(alarm.at)}: ${alarm.alarm}${bound}${now}${dead ? ", not known now: the line is lost" : ""}`;
}

function values(now, sigma, old, bad) {
  cards.forEach(({output, place, figure, small, spread, also}, k) => {
    const by = factor(output), sd = sigma[k] * by, there = now[k] !== null;
    if (output.input && there) place.hidden = false;
    place.classList.toggle("old", old);
    put(figure, !there ? "-" : output.input ? figures(now[k]) : number(now[k] * by, sd));
    put(small, ` ${unit(output)}`);
    if (output.input) return;
    put(spread, bad ? "not known now" : `± ${number(2 * sd, sd)} ${unit(output)} (2σ)`);
    // As wide as the sensor's own size of an error: what comes does not tell the value.
    put(also, !bad && output.scale && 2 * sigma[k] > output.scale ? "Not told by what comes: nothing excites the motor, or too little has been seen." : "");
  });
}

function count(live, dead) {
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
    rows.push([`time to the limit: ${alarm}`, dead ? "not known" : left === null ? "not in sight" : duration(left), ""]);
  const body = $("counts").tBodies[0];
  while (body.rows.length > rows.length) body.deleteRow(-1);
  rows.forEach((row, k) => fill(body.rows[k] || body.insertRow(), "td", row));
}

// What is watched: those set on a page, which a page may take away, and those of whoever started the runtime.
function limits(all) {
  const list = $("limits"), names = all.map(limit => `${limit.own ? "own " : ""}${limit.name}`).join("\n");
  if (list.dataset.names === names) return;
  list.dataset.names = names;
  list.replaceChildren();
  all.forEach(limit => {
    const output = about.outputs[limit.column], bound = `${output.name} ${limit.side > 0 ? ">" : "<"} ${limit.limit}`;
    const item = make("li", "", list), plain = limit.name === bound ? "" : `${limit.name}: `;
    make("span", `${plain}${bound} ${output.unit}${limit.own ? "" : ", given at the start"}`, item);
    if (!limit.own) return;
    const button = make("button", "Remove", item);
    button.setAttribute("aria-label", `Remove the limit ${limit.name}`);
    button.onclick = () => send("/limit", {motor, remove: limit.name});
  });
}

async function send(path, asked) {
  try {
    await ask(path, asked);
    put($("limit-said"), "");
    return true;
  } catch (error) {
    put($("limit-said"), error.message);
    return false;
  }
}

function gone(why) {
  state("bad", `No answer from the runtime${why && !why.includes("fetch") ? ": " + why : ""}`);
  cards.forEach(({place}) => place.classList.add("old"));
}

function state(kind, words) {
  $("status").className = `verdict ${kind}`;
  put($("status"), words);
  const mark = {good: "", uncertain: "▲ ", bad: "■ "}[kind] || "";
  if (document.title !== mark + words) document.title = mark + words;
}

function overview(found) {
  motors = found;
  $("motors").hidden = false;
  while ($("motors").childElementCount < found.length) make("button", "", $("motors")).type = "button";
  found.forEach((one, k) => {
    const button = $("motors").children[k], latest = one.latest, bad = !latest || latest.age_s > SILENT_S || latest.status === "bad";
    const mark = bad ? "■ bad" : latest.status === "good" ? "● good" : "▲ uncertain";
    put(button, `${one.motor}: ${mark}${one.alarms ? `, ${one.alarms} on alarm` : ""}`);
    button.toggleAttribute("aria-current", k === motor);
    button.onclick = () => { motor = k; about = null; before = null; release(); choose(windowS); };
  });
}

function draw() {
  const picture = player || held || {data: shown, span: [end() - windowS, end()]};
  cards.forEach((card, k) => { if (!card.place.hidden) card.plot.draw(picture.data, k, picture.span); });
}

// Hold: a picture of this moment; what comes meanwhile is gathered behind it.
function hold(span) {
  const copy = rows => rows.map(row => row.slice());
  if (!complete) { wantsHold = true; return; } // rows of this window are still coming
  wantsHold = false;
  if (!held) held = {at: Date.now() / 1000, data: {time: shown.time.slice(), doubt: shown.doubt.slice(), values: copy(shown.values), sigma: copy(shown.sigma)}, span: [end() - windowS, end()]};
  if (span) held.span = span;
  $("hold").setAttribute("aria-pressed", true);
  $("held").hidden = false;
  put($("held"), `Held since ${clock(held.at)}${span ? "; a part, twice click to be back" : ""}`);
  draw();
}

function release() {
  held = null;
  wantsHold = false;
  cards.forEach(card => { card.plot.range = null; });
  $("hold").setAttribute("aria-pressed", false);
  $("held").hidden = true;
  if (cards.length) draw();
}

function zoom(from, to) {
  if (from === null) {
    cards.forEach(card => { card.plot.range = null; });
    if (player) { player.span = [player.data.time[0], player.data.time.at(-1)]; draw(); } else release();
  } else if (player) { player.span = [from, to]; player.runs = false; put($("run"), "Play"); draw(); } else hold([from, to]);
}

function pointed(plot, index) {
  cards.forEach(card => {
    const {output, at} = card, drawn = card.plot.data, row = index === null || index === undefined ? null : index;
    const value = row === null ? null : drawn[ESTIMATE][row] ?? drawn[DEAD][row];
    if (value === null || value === undefined) { put(at, ""); return; }
    const band = output.input || drawn[LOW][row] === null ? 0 : drawn[ESTIMATE][row] - drawn[LOW][row];
    put(at, `${output.input ? figures(value) : `${number(value, band / 2)} ± ${number(band, band / 2)}`} at ${clock(drawn[0][row])}`);
  });
}

function choose(seconds) {
  windowS = seconds;
  shown = nothing();
  complete = false;
  release();
  for (const button of $("windows").querySelectorAll("[data-seconds]"))
    button.setAttribute("aria-pressed", Number(button.dataset.seconds) === seconds);
}

function play(data, name) {
  release();
  player = {data, name, span: [data.time[0], data.time.at(-1)], runs: false, at: data.time.at(-1)};
  $("player").hidden = false;
  put($("playing"), `Recording ${name}`);
  put($("run"), "Play");
  cards.forEach((card, k) => { if (card.output.input) card.place.hidden = data.values[k].every(v => v === null); });
  shows(1);
  draw();
}

// The values of a recording at a share of its length.
function shows(share) {
  const {data} = player, first = data.time[0], until = data.time.at(-1);
  player.at = first + share * (until - first);
  let row = 0;
  while (row + 1 < data.time.length && data.time[row + 1] <= player.at) row++;
  values(data.values.map(column => column[row]), data.sigma.map(column => column[row]), false, data.doubt[row] === 2);
  $("position").value = share;
}

function step(passedS) {
  if (!player || !player.runs) return;
  const first = player.data.time[0], until = player.data.time.at(-1);
  const at = Math.min(player.at + passedS * Number($("pace").value), until);
  shows(until > first ? (at - first) / (until - first) : 1);
  player.span = [at - windowS, at];
  if (at >= until) { player.runs = false; put($("run"), "Play"); }
  draw();
}

function units() {
  $("unit").setAttribute("aria-pressed", rpm);
  const chosen = about && about.outputs.find(o => o.heading === $("quantity").value);
  if (chosen) put($("limit-unit"), unit(chosen));
}

function controls() {
  const button = (id, act) => { $(id).onclick = act; };
  WINDOWS.forEach(([name, seconds]) => {
    const one = make("button", name, $("windows"));
    one.type = "button";
    one.dataset.seconds = seconds;
    one.onclick = () => choose(seconds);
  });
  const still = make("button", "Hold", $("windows"));
  Object.assign(still, {type: "button", id: "hold", onclick: () => held || wantsHold ? release() : hold()});
  still.setAttribute("aria-pressed", false);
  button("record", () => send("/record", {motor, on: $("record").getAttribute("aria-pressed") !== "true"}));
  button("csv", () => {
    const picture = player || held || {data: shown, span: [end() - windowS, end()]};
    save("motorlens.csv", new Blob([csvOf(picture.data, picture.span, about.outputs)], {type: "text/csv"}));
  });
  button("png", async () => save("motorlens.png", await pngOf(cards.filter(card => !card.place.hidden).map(card => card.plot), `${$("about").textContent}, ${new Date().toLocaleString()}`)));
  button("open", () => $("file").click());
  $("file").onchange = async () => {
    const file = $("file").files[0];
    $("file").value = "";
    if (!file) return;
    try { play(readCsv(await file.text(), about), file.name); put($("limit-said"), ""); } catch (error) { put($("limit-said"), `${file.name} ${error.message}`); }
  };
  button("run", () => {
    player.runs = !player.runs;
    put($("run"), player.runs ? "Pause" : "Play");
    if (player.runs && player.at >= player.data.time.at(-1)) shows(0);
  });
  $("position").oninput = () => { shows(Number($("position").value)); step(0); };
  button("live", () => { player = null; $("player").hidden = true; release(); });
  button("unit", () => { rpm = !rpm; localStorage.setItem("rpm", rpm); units(); if (last) tell(last); release(); if (player) { shows(Number($("position").value)); draw(); } });
  $("quantity").onchange = units;
  $("limit").onsubmit = async event => {
    event.preventDefault();
    const output = about.outputs.find(o => o.heading === $("quantity").value);
    const asked = {motor, quantity: output.heading, side: $("side").value, limit: Number($("value").value) / factor(output)};
    if (await send("/limit", asked)) $("value").value = "";
  };
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select")) return;
    const chosen = WINDOWS[Number(event.key) - 1];
    if (event.key !== " " && chosen) choose(chosen[1]);
    else if (event.key === " " && event.target === document.body) { event.preventDefault(); still.click(); }
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => cards.forEach(card => card.plot.again()));
  let then = performance.now();
  setInterval(() => { const now = performance.now(); step((now - then) / 1000); then = now; }, 100);
}
