"use strict";
// The workbench: asks the server for steps, follows them, shows what came of each.
const $ = id => document.getElementById(id);
const TABS = ["look", "compare", "diagnose", "add", "again"];
const LOOK_MS = 400;
const problems = new Map(); // what was asked for -> why it was not done
const catalogue = new Map(); // name of an effect -> its equation and meaning
let steps = [], outputSuggested = "", running = null, seen = false; // seen: whether this page knows what was before

start();

async function start() {
  history.replaceState(null, "", location.pathname + location.hash); // the key need not stand in the address line
  TABS.forEach((name, k) => {
    $(`tab-${name}`).onclick = () => open_(name);
    $(`tab-${name}`).onkeydown = event => {
      const to = {ArrowRight: k + 1, ArrowLeft: k - 1 + TABS.length, Home: 0, End: TABS.length - 1}[event.key];
      if (to === undefined) return;
      event.preventDefault();
      open_(TABS[to % TABS.length], true);
    };
  });
  addEventListener("keydown", event => {
    const typing = event.target.matches("input, textarea, select");
    if (!typing && !event.ctrlKey && !event.metaKey && !event.altKey && Number(event.key) >= 1 && Number(event.key) < TABS.length) open_(TABS[Number(event.key)], true);
  });
  // What the user does next takes the place of what went wrong before: as it is typed, for were it when a button is pressed, the
  // button would move away under the pointer.
  for (const kind of ["click", "input", "submit"]) addEventListener(kind, event => { if (event.target.closest("button, input, select, form")) forget(); }, true);
  addEventListener("popstate", () => open_(TABS.includes(location.hash.slice(1)) ? location.hash.slice(1) : "compare", false, true));
  for (const button of document.querySelectorAll("button.run:not([type=submit])")) button.onclick = () => take({kind: button.dataset.kind});
  $("add-form").onsubmit = event => {
    event.preventDefault();
    const strange = named().find(name => !catalogue.has(name));
    if (catalogue.size && strange) return problem(`${strange} is not in the catalogue; choose one of the list.`, "/steps");
    return take(change("add", named().join(" "), $("output").value.trim()));
  };
  $("effect").oninput = () => { suggest(); explain(); };
  $("cancel").onclick = () => send("/cancel", {});
  $("script").onclick = () => copy(steps.filter(s => s.state === "done" && s.kind !== "look").map(s => s.command).join("\n") + "\n", $("script"));
  open_(TABS.includes(location.hash.slice(1)) ? location.hash.slice(1) : "compare", false, true);
  try {
    await Files.start(() => { showParts(); suggest(); age(); });
  } catch (error) {
    problem(error.message, "/state");
  }
  get("/effects").then(found => {
    found.effects.forEach(effect => catalogue.set(effect.name, effect));
    $("effects").replaceChildren(...found.effects.map(effect => new Option(effect.summary, effect.name)));
    explain();
    equations($("diagnose-result"));
  }).catch(() => {});
  for (;;) {
    try {
      await Files.ready();
      await follow();
      problem("", "/state");
    } catch (error) {
      problem(error.refused ? "The workbench was started again: open the address that it has printed." : "The workbench does not answer any more; start it again with the same command, and go on where you were.", "/state");
    }
    await new Promise(done => setTimeout(done, document.hidden ? 5 * LOOK_MS : LOOK_MS));
  }
}

function open_(name, focus, quiet) {
  for (const other of TABS) {
    $(other).hidden = other !== name;
    $(`tab-${other}`).setAttribute("aria-selected", other === name);
    $(`tab-${other}`).tabIndex = other === name ? 0 : -1;
  }
  if (!quiet && location.hash !== `#${name}`) history.pushState(null, "", `#${name}`);
  if (focus) $(`tab-${name}`).focus();
  scenes[name]?.fit();
}

async function get(path) {
  const reply = await fetch(path);
  if (!reply.ok) throw Object.assign(new Error((await reply.text()).trim()), {refused: reply.status === 403});
  return reply.json();
}

async function send(path, document_) {
  try {
    const reply = await fetch(path, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(document_)});
    const answer = await reply.json();
    problem(answer.error || "", path);
    return reply.ok ? answer : null;
  } catch (error) {
    problem("The workbench does not answer.", "/state");
    return null;
  }
}

// Why something was not done; "" once it was. Answers come in any order: one does not take away what another has said.
function problem(text, of) {
  if (text) problems.set(of, text);
  else problems.delete(of);
  const all = [...new Set(problems.values())].join(" ");
  if ($("problem").textContent !== all) $("problem").textContent = all;
  $("problem").hidden = !all;
}

// All but that nobody answers, which is so until somebody does.
function forget() {
  [...problems.keys()].filter(of => of !== "/state").forEach(of => problem("", of));
}

// For who does not see the page: one sentence when something has begun or ended.
function say(text) {
  $("said").textContent = text;
}

function showParts() {
  const present = Files.parts(), {motor, recordings, judge} = Files.chosen;
  $("present").replaceChildren();
  if (present.length) {
    put("h3", $("present"), "In the motor file now");
    const list = put("ul", $("present"));
    for (const name of present) {
      const item = put("li", list, words(name) + (Files.stated().includes(name) ? " (stated, never fitted)" : ""));
      const button = press(item, "Remove", `Remove ${words(name)}`, () => take(change("remove", name, free(`${stem()}_without_${name}`))));
      button.classList.add("run");
    }
  }
  $("inherit").replaceChildren();
  if (!motor) return;
  put("h3", $("inherit"), "The sensor inherits it");
  put("p", $("inherit"), "A sensor trained on the improved motor file, and its error on the same recordings:", "note");
  const all = [...recordings, ...judge];
  command(`motorlens train --motor ${quote(motor)} -o sensor.onnx`, $("inherit"));
  command(`motorlens evaluate sensor.onnx ${all.length ? all.map(quote).join(" ") : "RECORDING"} --motor ${quote(motor)}`, $("inherit"));
}

function quote(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\"'\"'")}'`;
}

function stem() {
  const name = Files.chosen.motor.split("/").pop().replace(/\.toml$/, "");
  return name.replace(/[^A-Za-z0-9_.+-]/g, "_") || "motor";
}

// A name that no motor file here has.
function free(name) {
  const taken = Files.there.motors.map(motor => motor.name.split("/").pop());
  let k = 1, found = `${name}.toml`;
  while (taken.includes(found)) found = `${name}_${++k}.toml`;
  return found;
}

// The effects that are to be added, as the catalogue has them.
function named() {
  return $("effect").value.split(",").map(name => name.trim().replaceAll(" ", "_")).filter(name => name);
}

function suggest() {
  const effect = named().join("_");
  if ($("output").value && $("output").value !== outputSuggested) return; // the user's own
  outputSuggested = effect && Files.there ? free(`${stem()}_${effect}`) : "";
  $("output").value = outputSuggested;
}

// What the effects that are named mean, and their equations.
function explain() {
  $("meaning").replaceChildren();
  for (const effect of named().map(name => catalogue.get(name)).filter(effect => effect)) {
    const place = put("div", $("meaning"));
    put("span", place, effect.summary);
    effect.equations.forEach(line => { put("br", place); put("code", place, line); });
  }
}

function change(kind, effect, output) {
  return {kind, effect, output, force: kind === "add" && $("force").checked};
}

async function take(order) {
  if (running) return problem("A step is under way; wait for it or cancel it.", "/busy");
  try {
    await Files.ready();
  } catch (error) {
    return problem(error.message, "/state");
  }
  const step = await send("/steps", {...Files.chosen, ...order});
  if (step) await follow();
  return step;
}

async function follow() {
  const state = await get("/state");
  running = state.steps.find(step => step.state === "running") || null;
  const {hidden} = $("running");
  $("running").hidden = !running;
  if (!running) problem("", "/busy");
  // Not `disabled`: the focus stays where it is.
  if (hidden === Boolean(running)) document.querySelectorAll(".run").forEach(button => button.setAttribute("aria-disabled", Boolean(running)));
  if (running) {
    const what = running.kind + (running.effect ? ` ${words(running.effect)}` : "");
    if (hidden) say(`${what} has begun`);
    $("running-what").textContent = what;
    $("running-since").textContent = `${running.seconds.toFixed(0)} s`;
    $("running-line").textContent = (state.progress.at(-1) || "at work; the first time on a machine, simulations are compiled for it").replace(/^\d+(\.\d+)? s +/, "");
  }
  const changed = state.steps.filter((step, k) => !steps[k] || steps[k].state !== step.state);
  const fresh = seen;
  seen = true;
  steps = state.steps;
  if (changed.length) await tell(changed, fresh);
  await show("look", ["look"], columns);
  await show("compare", ["compare"]);
  await show("diagnose", ["diagnose"], candidates);
  await show("add", ["add", "remove"]);
  await showAgain();
}

async function tell(changed, fresh) {
  const ended = changed.filter(step => step.state !== "running").at(-1);
  if (ended && fresh) {
    say(`${ended.kind} ${ended.state}: ${ended.sentence}`);
    if (ended.written && ended.number === steps.length) {
      $("effect").value = $("output").value = "";
      explain();
      await Files.read(ended.written);
      Files.set({motor: ended.written});
    }
  }
  showSteps();
  Files.show();
}

function showSteps() {
  $("no-steps").hidden = steps.length > 0;
  $("script").hidden = !steps.some(step => step.state === "done" && step.kind !== "look");
  $("steps").replaceChildren(...steps.map(step => {
    const item = put("li", null, null, step.state);
    put("div", item, step.state === "running" ? "under way" : `${typeset(step.sentence)} (${step.seconds.toFixed(1)} s)`);
    command(step.command, item);
    return item;
  }));
}

function command(text, parent) {
  const row = put("div", parent, null, "command");
  put("pre", row, text).tabIndex = 0;
  const button = press(row, "Copy", `Copy ${text}`, () => copy(text, button));
}

async function copy(text, button) {
  await navigator.clipboard.writeText(text);
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = before; }, 1200);
}
