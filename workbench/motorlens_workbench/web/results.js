"use strict";
// What came of a step: its report, taken into this page, with what can be done about it.
const scenes = {}; // place -> the pictures drawn there
const UNITS = {current: "A", speed: "rad/s", temperature: "°C"};

function words(name) {
  return name.replaceAll("_", " ");
}

// What a command has said, as it is printed in a book.
function typeset(text) {
  return text.replaceAll("+-", "±");
}

// Draws a step into its place once; one that could not be fetched is fetched again when the server answers.
async function once(parent, step, draw) {
  const number = String(step.number);
  if (parent.dataset.step === number) return;
  parent.dataset.step = number;
  try {
    await draw();
  } catch (error) {
    if (parent.dataset.step === number) delete parent.dataset.step;
    throw error;
  }
}

// What came of the newest step of a kind; where it failed, what the one before it found stays below, and says so.
async function show(name, kinds, also = () => {}) {
  const parent = $(`${name}-result`), ended = steps.filter(step => kinds.includes(step.kind) && step.state !== "running");
  const last = ended.at(-1), good = ended.findLast(step => step.state === "done");
  if (last) await once(parent, last, () => draw(name, parent, last, good, also));
}

async function draw(name, parent, last, good, also) {
  const parts = document.createDocumentFragment();
  if (last !== good) head(last, parts);
  let drawn = null;
  // A recording that cannot be used as it is shows its columns, to choose what they are.
  const shown = last.kind === "look" && last.state === "failed" ? last : good;
  if (shown) {
    const box = put("div", parts, null, "found");
    box.dataset.step = shown.number;
    if (shown === good) {
      put("p", box, "", "stale note");
      head(good, box);
    }
    drawn = await embed(shown, box);
    await also(shown, box);
  }
  scenes[name]?.close();
  parent.replaceChildren(parts);
  scenes[name] = drawn && drawn();
  age();
}

function head(step, parent) {
  put("p", parent, typeset(step.sentence), step.state === "done" ? "verdict" : "failed");
  step.notes.forEach(note => put("p", parent, typeset(note), "note"));
  command(step.command, parent);
  if (step.state !== "done") return;
  const row = put("p", parent, null, "row");
  for (const [kind, text] of [["html", "Download the report"], ["json", "Download the numbers"]]) {
    const link = put("a", row, text);
    link.href = `/results/${step.number}.${kind}`;
    link.download = `${step.number}_${step.kind}.${kind}`;
  }
  if (step.written) {
    const link = put("a", row, "Download the motor file");
    link.href = `/file?name=${encodeURIComponent(step.written)}`;
    link.download = step.written.split("/").pop();
  }
  const link = put("a", row, "Open the report in a tab");
  link.href = `/results/${step.number}.html`;
  link.target = "_blank";
}

// The report's own sections; its scripts do not run here, this page has them. Returns how to draw the plots once they are
// in the page.
async function embed(step, parent) {
  const reply = await fetch(`/results/${step.number}.html`);
  if (!reply.ok) return null;
  const text = await reply.text(); // its style stays outside: this page has it
  const report = new DOMParser().parseFromString(text.slice(text.indexOf("<body")), "text/html"), body = put("div", parent, null, "report");
  const skip = "h1, .verdict, .again, script";
  for (const part of [...report.querySelector("main").children]) if (!part.matches(skip) && !/^motorlens [\d.]+/.test(part.textContent)) body.append(document.importNode(part, true));
  return () => new Scene(body, report, {range: step.kind === "add" || step.kind === "remove" ? null : (name, from, to) => Files.range(name, from, to, step)});
}

// A choice that has changed since: what is shown is of another motor file, recording, column or range.
function age() {
  for (const box of document.querySelectorAll(".found")) {
    const step = steps[Number(box.dataset.step) - 1], note = box.querySelector(".stale");
    if (!step || !note) continue;
    const now = Files.chosen, differs = [];
    const motor = step.written || step.motor;
    if (step.kind !== "look" && motor !== now.motor) differs.push(motor);
    if (step.kind !== "look" && String(step.recordings) !== String(now.recordings)) differs.push(step.recordings.join(", "));
    if (String(Files.columnsOf(step.recordings, step.columns)) !== String(Files.columnsOf(step.recordings))) differs.push("other columns");
    if (step.kind !== "look" && String(ranges(step.ranges, step)) !== String(ranges(now.ranges, step))) differs.push(step.ranges.length ? `ranges ${step.ranges.join(", ")}` : "whole recordings");
    if (step.kind !== "look" && conditions(step) !== conditions(now)) differs.push(conditions(step) || "conditions as recorded");
    box.classList.toggle("old", differs.length > 0);
    note.textContent = differs.length ? `Of an earlier choice: ${differs.join("; ")}.` : "";
  }
}

function ranges(list, step) {
  return list.filter(text => ["", ...step.recordings, ...step.judge].includes(rangeParts(text)[0]));
}

// Under each candidate's name, where no table is too wide to show it: the way to add it, unless a note says why not.
function candidates(step, box) {
  for (const row of box.querySelectorAll("tr[data-name]")) {
    const place = put("div", row.cells[0], null, "row");
    if (!row.cells[row.cells.length - 1].textContent.trim()) press(place, "Add…", `Add ${words(row.dataset.name)}`, () => {
      $("effect").value = row.dataset.name;
      $("effect").dispatchEvent(new Event("input"));
      open_("add");
      $("effect").focus();
    });
  }
  equations(box);
}

// And its equation. The catalogue comes later than what an earlier session has found.
function equations(box) {
  for (const place of box.querySelectorAll("tr[data-name] td:first-child > .row")) {
    const effect = catalogue.get(place.closest("tr").dataset.name);
    if (!effect || place.querySelector("details")) continue;
    const about = put("details", place);
    put("summary", about, "equation");
    effect.equations.forEach(line => put("code", put("div", about), line));
    put("div", about, effect.summary);
  }
}

// Beside each column: what it is taken for, and in which unit.
async function columns(step, box) {
  const found = await get(`/results/${step.number}.json`);
  const table_ = box.querySelector("tr[data-name]")?.closest("table");
  if (!table_) return;
  const notes = put("p", null, "Choose what a column is, where its name does not say so; then it is looked at again.", "note");
  table_.closest(".scroll").before(notes);
  for (const row of table_.tBodies[0].rows) {
    const heading = row.dataset.name, entry = found.columns.find(one => one.heading === heading), cell = row.cells[1];
    if (!entry) continue;
    const mapped = Files.columnsOf(step.recordings, step.columns).map(text => columnParts(text)[1]).find(column => column.slice(column.indexOf("=") + 1) === heading)?.split("=")[0] || "";
    cell.textContent = "";
    const what = put("select", cell), unit = put("select", cell);
    what.append(new Option("not used", ""), ...Object.keys(found.choices).map(name => new Option(words(name), name)));
    what.value = entry.quantity;
    what.setAttribute("aria-label", `what ${heading} is`);
    unit.setAttribute("aria-label", `unit of ${heading}`);
    const units = () => {
      unit.hidden = !what.value;
      unit.replaceChildren(new Option("as its name says", ""), ...(found.choices[what.value] || []).map(name => new Option(name)));
      unit.value = mapped.startsWith(`${what.value}_`) ? mapped.slice(what.value.length + 1) : "";
    };
    units();
    const map = () => { Files.map(step.recordings[0], what.value, unit.value, heading); Files.look(step.recordings[0]); };
    what.onchange = () => { units(); map(); };
    unit.onchange = map;
  }
  computed(step, Object.keys(found.choices), table_.closest(".scroll"));
}

// What no column holds is computed from several, as `--column` does it; what the command has proposed stands there.
function computed(step, quantities, after) {
  const form = document.createElement("form"), what = document.createElement("select"), formula = document.createElement("input");
  const proposed = step.sentence.match(/--column '([a-z_]+)=([^']+)'/) || [null, "voltage", ""];
  const own = Files.columnsOf(step.recordings, step.columns).map(text => columnParts(text)[1]).find(column => /[*/]/.test(column.split("=")[1]));
  form.className = "row computed";
  put("span", form, "or compute");
  what.append(...quantities.map(name => new Option(words(name), name)));
  what.value = own ? own.split("=")[0] : proposed[1];
  what.setAttribute("aria-label", "what is computed");
  formula.type = "text";
  formula.required = true;
  formula.spellcheck = false;
  formula.placeholder = "duty_pct*U_bat [V]/100";
  formula.value = own ? own.slice(own.indexOf("=") + 1) : proposed[2];
  formula.setAttribute("aria-label", "formula over the columns");
  form.append(what, "=", formula);
  put("button", form, "Use it");
  form.onsubmit = event => {
    event.preventDefault();
    Files.map(step.recordings[0], what.value, "", formula.value.trim());
    Files.look(step.recordings[0]);
  };
  after.after(form);
}

// Every motor file that was compared with the same recordings, the oldest first, over each other.
async function showAgain() {
  const last = steps.findLast(step => step.kind === "compare" && step.state === "done"), parent = $("again-result");
  if (last) await once(parent, last, () => drawAgain(parent, last));
}

async function drawAgain(parent, last) {
  const same = steps.filter(step => step.kind === "compare" && step.state === "done" && String(step.recordings) === String(last.recordings) && String(step.ranges) === String(last.ranges));
  // A file that was compared twice is shown as it is now.
  const newest = same.filter((step, k) => !same.slice(k + 1).some(later => later.motor === step.motor));
  const results = await Promise.all(newest.map(step => get(`/results/${step.number}.json`)));
  const parts = document.createDocumentFragment(), box = put("div", parts, null, "found");
  box.dataset.step = last.number;
  put("p", box, "", "stale note");
  head(last, box);
  for (const [channel, found] of Object.entries(results.at(-1).channels))
    bars(`Error of ${channel}, run freely, ${UNITS[channel] || found.unit}`, [...newest.map((step, k) => [step.motor, results[k].channels[channel]?.rmse]), ["noise floor", found.noise_floor, "noise"]], box);
  const drawn = await embed(last, box);
  scenes.again?.close();
  parent.replaceChildren(parts);
  scenes.again = drawn && drawn();
  age();
}

// As the reports draw them.
function bars(heading, rows, parent) {
  const table_ = put("table", parent, null, "bars"), most = Math.max(...rows.map(([, value]) => value || 0), 1e-300);
  put("caption", table_, heading);
  const body = put("tbody", table_);
  for (const [name, value, kind] of rows) {
    const row = put("tr", body);
    put("th", row, name).scope = "row";
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    svg.setAttribute("viewBox", "0 0 100 1");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("aria-hidden", "true");
    for (const [part, width] of [["track", 100], [kind || "predicted", 100 * (value || 0) / most]]) {
      const rect = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      rect.setAttribute("class", part);
      rect.setAttribute("width", width);
      rect.setAttribute("height", 1);
      svg.append(rect);
    }
    put("td", row, null, "bar").append(svg);
    put("td", row, value === undefined ? "–" : short(value, 4));
  }
}
