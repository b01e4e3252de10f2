"use strict";
// The workbench: chooses files, asks the server for steps, follows them, shows what came of each.
const $ = id => document.getElementById(id);
const TABS = ["compare", "diagnose", "add", "again"];
const LOOK_MS = 400;
const results = new Map(); // number of a step -> what it found
let choice = null, steps = [], outputSuggested = "";

start();

async function start() {
  history.replaceState(null, "", location.pathname + location.hash); // the key need not stand in the address line
  TABS.forEach((name, k) => {
    $(`tab-${name}`).onclick = () => open_(name);
    $(`tab-${name}`).onkeydown = event => {
      const move = {ArrowRight: 1, ArrowLeft: -1}[event.key];
      if (move) open_(TABS[(k + move + TABS.length) % TABS.length], true);
    };
  });
  addEventListener("keydown", event => {
    const typing = event.target.matches("input[type=text], textarea, select");
    if (!typing && !event.ctrlKey && !event.metaKey && !event.altKey && TABS[Number(event.key) - 1]) open_(TABS[Number(event.key) - 1], true);
  });
  for (const button of document.querySelectorAll("button.run:not([type=submit])")) button.onclick = () => take({kind: button.dataset.kind});
  $("add-form").onsubmit = event => { event.preventDefault(); take(change("add", $("effect").value.trim(), $("output").value.trim())); };
  $("effect").oninput = suggest;
  $("motor").onchange = () => { showParts(); suggest(); };
  $("refresh").onclick = () => choose();
  $("cancel").onclick = () => send("/cancel", {});
  $("script").onclick = () => copy(steps.filter(s => s.state === "done").map(s => s.command).join("\n") + "\n", $("script"));
  // A page that is opened again goes on from the last step.
  const last = (await get("/state")).steps.at(-1);
  await choose(last && (last.written || last.motor), last);
  const wanted = TABS.indexOf(location.hash.slice(1));
  open_(TABS[Math.max(wanted, 0)]);
  for (let answered = true;;) {
    try {
      await follow();
      if (!answered) problem("");
      answered = true;
    } catch (error) {
      answered = false;
      problem("The workbench does not answer any more; start it again.");
    }
    await new Promise(done => setTimeout(done, document.hidden ? 5 * LOOK_MS : LOOK_MS));
  }
}

function open_(name, focus) {
  for (const other of TABS) {
    $(other).hidden = other !== name;
    $(`tab-${other}`).setAttribute("aria-selected", other === name);
    $(`tab-${other}`).tabIndex = other === name ? 0 : -1;
  }
  history.replaceState(null, "", `#${name}`);
  if (focus) $(`tab-${name}`).focus();
}

async function get(path) {
  const reply = await fetch(path);
  if (!reply.ok) throw new Error((await reply.text()).trim());
  return reply.json();
}

async function send(path, document_) {
  const reply = await fetch(path, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(document_)});
  const answer = await reply.json();
  problem(answer.error || "");
  return reply.ok ? answer : null;
}

function problem(text) {
  $("problem").textContent = text;
  $("problem").hidden = !text;
}

// What can be chosen; what is chosen stays so.
async function choose(motor, kept) {
  const before = choice ? {motor: $("motor").value, ...chosen()} : kept;
  choice = await get("/choice");
  const now = before || {...choice.chosen, judge: []};
  $("motor").replaceChildren(...choice.motors.map(entry => new Option(entry.name)));
  if (!choice.motors.length) $("motor").append(new Option("no motor file here", ""));
  $("motor").value = motor || now.motor || (choice.motors.length ? choice.motors[0].name : "");
  const body = $("recordings").tBodies[0];
  body.replaceChildren();
  for (const name of choice.recordings) {
    const row = make("tr", null, body);
    make("td", name, row);
    const use = box(row, `use ${name}`, now.recordings.includes(name));
    const judge = box(row, `judge by ${name}`, now.judge.includes(name));
    use.name = "use";
    judge.name = "judge";
    use.value = judge.value = name;
    use.onchange = () => { if (use.checked) judge.checked = false; };
    judge.onchange = () => { if (judge.checked) use.checked = false; };
  }
  if (!choice.recordings.length) make("td", "no recording here", make("tr", null, body));
  $("columns").value = now.columns.join(" ");
  $("effects").replaceChildren(...choice.effects.map(name => new Option(name, name)));
  showParts();
  suggest();
}

function box(row, label, checked) {
  const found = make("input", null, make("td", null, row));
  found.type = "checkbox";
  found.checked = checked;
  found.setAttribute("aria-label", label);
  return found;
}

function chosen() {
  const ticked = name => [...document.querySelectorAll(`#recordings input[name=${name}]:checked`)].map(input => input.value);
  return {recordings: ticked("use"), judge: ticked("judge"), columns: $("columns").value.split(/\s+/).filter(Boolean)};
}

function parts() {
  const entry = choice.motors.find(motor => motor.name === $("motor").value);
  return entry ? entry.parts : [];
}

function showParts() {
  const present = parts();
  $("parts").textContent = present.length ? `textbook + ${present.map(words).join(" + ")}` : "the textbook motor, no effects";
  $("present").replaceChildren();
  if (present.length) {
    make("h3", "In the motor file now", $("present"));
    const list = make("ul", null, $("present"));
    for (const name of present) {
      const item = make("li", words(name), list);
      const button = make("button", "Remove", item, "run");
      button.type = "button";
      button.setAttribute("aria-label", `Remove ${words(name)}`);
      button.onclick = () => take(change("remove", name, free(`${stem()}_without_${name}`)));
    }
  }
  const motor = $("motor").value, all = [...chosen().recordings, ...chosen().judge];
  $("inherit").replaceChildren();
  if (!motor) return;
  make("h3", "The sensor inherits it", $("inherit"));
  make("p", "A sensor trained on the improved motor file, and its error on the same recordings:", $("inherit"), "note");
  command(`motorlens train --motor ${quote(motor)} -o sensor.onnx`, $("inherit"));
  command(`motorlens evaluate sensor.onnx ${all.length ? all.map(quote).join(" ") : "RECORDING"} --motor ${quote(motor)}`, $("inherit"));
}

function quote(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\"'\"'")}'`;
}

function stem() {
  const name = $("motor").value.split("/").pop().replace(/\.toml$/, "");
  return name.replace(/[^A-Za-z0-9_.+-]/g, "_") || "motor";
}

// A name that no motor file here has.
function free(name) {
  const taken = choice.motors.map(motor => motor.name.split("/").pop());
  let k = 1, found = `${name}.toml`;
  while (taken.includes(found)) found = `${name}_${++k}.toml`;
  return found;
}

function suggest() {
  const effect = $("effect").value.trim();
  if ($("output").value && $("output").value !== outputSuggested) return; // the user's own
  outputSuggested = effect ? free(`${stem()}_${effect}`) : "";
  $("output").value = outputSuggested;
}

function change(kind, effect, output) {
  return {kind, effect, output, force: kind === "add" && $("force").checked};
}

async function take(order) {
  const step = await send("/steps", {motor: $("motor").value, ...chosen(), ...order});
  if (step) await follow();
}

async function follow() {
  const state = await get("/state");
  const running = state.steps.find(step => step.state === "running");
  $("running").hidden = !running;
  for (const button of document.querySelectorAll(".run")) button.disabled = Boolean(running);
  if (running) {
    $("running-what").textContent = running.kind + (running.effect ? ` ${words(running.effect)}` : "");
    $("running-since").textContent = `${running.seconds.toFixed(0)} s`;
    $("running-line").textContent = (state.progress.at(-1) || "starting").replace(/^\d+(\.\d+)? s +/, "");
  }
  const changed = state.steps.filter((step, k) => !steps[k] || steps[k].state !== step.state);
  steps = state.steps;
  if (!changed.length) return;
  for (const step of changed) {
    if (step.state === "done") results.set(step.number, await get(`/results/${step.number}.json`));
    if (step.written && step.number === steps.length) {
      $("effect").value = $("output").value = "";
      await choose(step.written);
    }
  }
  showSteps();
  show("compare", ["compare"], SHOW.compare);
  show("diagnose", ["diagnose"], SHOW.diagnose);
  show("add", ["add", "remove"], SHOW.add);
  showAgain(steps.findLast(step => step.kind === "compare" && step.state === "done"));
}

// What came of the newest step of a kind; where it failed, what the one before it found stays below.
function show(name, kinds, drawing) {
  const parent = $(`${name}-result`), ended = steps.filter(step => kinds.includes(step.kind) && step.state !== "running");
  const last = ended.at(-1), good = ended.findLast(step => step.state === "done");
  if (!last || parent.dataset.step === String(last.number)) return;
  parent.replaceChildren();
  parent.dataset.step = last.number;
  if (last !== good) head(last, parent);
  if (!good) return;
  head(good, parent);
  drawing(results.get(good.number), parent, effect => {
    $("effect").value = effect;
    suggest();
    open_("add");
    $("effect").focus();
  });
  report(good, parent, Boolean(results.get(good.number).unknown_shape));
}

function head(step, parent) {
  make("p", step.sentence, parent, step.state === "done" ? "verdict" : "failed");
  step.notes.forEach(note => make("p", note, parent, "note"));
  command(step.command, parent);
}

function showAgain(last) {
  const parent = $("again-result");
  parent.replaceChildren();
  if (!last) return;
  const same = steps.filter(step => step.kind === "compare" && step.state === "done" && String(step.recordings) === String(last.recordings));
  make("p", last.sentence, parent, "verdict");
  // A file that was compared twice is shown as it is now.
  const newest = same.filter((step, k) => !same.slice(k + 1).some(later => later.motor === step.motor));
  SHOW.again(newest.map(step => results.get(step.number)), parent);
  command(last.command, parent);
  report(last, parent);
}

function report(step, parent, opened) {
  const box_ = make("details", null, parent), path = `/results/${step.number}.html`;
  make("summary", "Full report, with pictures to zoom into", box_);
  const link = make("a", "Open it in a tab of its own", make("p", null, box_, "note"));
  link.parentElement.style.padding = "0 .9rem";
  link.href = path;
  link.target = "_blank";
  box_.ontoggle = () => {
    if (box_.open && !box_.querySelector("iframe")) {
      const frame = make("iframe", null, box_);
      frame.title = `Report of ${step.command}`;
      frame.loading = "lazy"; // it is drawn for the width it is seen at
      frame.src = path;
    }
  };
  box_.open = Boolean(opened);
}

function showSteps() {
  $("no-steps").hidden = steps.length > 0;
  $("script").hidden = !steps.some(step => step.state === "done");
  $("steps").replaceChildren(...steps.map(step => {
    const item = make("li", null, null, step.state);
    make("div", step.state === "running" ? "under way" : `${step.sentence} (${step.seconds.toFixed(1)} s)`, item);
    command(step.command, item);
    return item;
  }));
}

function command(text, parent) {
  const row = make("div", null, parent, "command");
  make("pre", text, row);
  const button = make("button", "Copy", row);
  button.type = "button";
  button.onclick = () => copy(text, button);
}

async function copy(text, button) {
  await navigator.clipboard.writeText(text);
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = before; }, 1200);
}
