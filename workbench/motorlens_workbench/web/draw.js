"use strict";
// What came of a step, from the document its command writes with --json.
const UNITS = {current: "A", speed: "rad/s", temperature: "°C"};

function make(tag, text, parent, classes) {
  const element = document.createElement(tag);
  if (text !== undefined && text !== null) element.textContent = text;
  if (classes) element.className = classes;
  if (parent) parent.append(element);
  return element;
}

function number(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  if (typeof value !== "number") return String(value);
  return Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
}

function words(name) {
  return name.replaceAll("_", " ");
}

function unit(text) {
  return {degC: "°C", 1: ""}[text] ?? text;
}

function table(headings, rows, parent) {
  const found = make("table", null, make("div", null, parent, "scroll"));
  const head = make("tr", null, make("thead", null, found));
  headings.forEach(heading => make("th", heading, head).scope = "col");
  const body = make("tbody", null, found);
  for (const row of rows) {
    const line = make("tr", null, body);
    for (const cell of row) {
      if (cell instanceof Node) make("td", null, line).append(cell);
      else make("td", number(cell), line);
    }
  }
  return found;
}

// Bars under one another: [name, value, is it the noise floor].
function bars(heading, rows, parent) {
  make("h3", heading, parent);
  const box = make("div", null, parent, "bars");
  const most = Math.max(...rows.map(([, value]) => value || 0), 1e-300);
  for (const [name, value, floor] of rows) {
    make("span", name, box, "name");
    const fill = make("div", null, make("div", null, box, "track"), floor ? "fill floor" : "fill");
    fill.style.width = `${100 * (value || 0) / most}%`;
    make("span", number(value), box, "number");
  }
}

function rungName(rung) {
  if (!rung.added) return "textbook";
  return rung.added.startsWith("without ") ? words(rung.added) : `+ ${words(rung.added)}`;
}

const SHOW = {
  compare(result, parent) {
    table(["channel", "error, rms", "times its noise", "fit, %", "bias", "largest", "noise"],
      Object.entries(result.channels).map(([name, c]) =>
        [`${name}, ${unit(c.unit)}`, c.rmse, Number((c.rmse / c.noise_floor).toPrecision(2)), Number(c.nrmse_percent.toFixed(1)), c.bias, c.max, c.noise_floor]), parent);
    const testable = Object.entries(result.equations).filter(([, e]) => e.testable);
    if (testable.length) bars("Which equation fails, share in percent", testable.map(([name, e]) => [name, Number((100 * e.share).toFixed(1))]), parent);
    for (const [name, e] of Object.entries(result.equations)) if (e.why) make("p", `${name}: ${e.why}`, parent, "note");
    const regions = Object.entries(result.named_regions || {});
    if (regions.length) bars("Where it fails, error in multiples of the noise", regions.map(([name, r]) => [name, r.rms_in_sigma]), parent);
  },

  diagnose(result, parent, act) {
    if (result.separating_experiment && result.separating_experiment.why)
      make("p", `To tell ${result.separating_experiment.separates.map(words).join(", ")} apart: ${result.separating_experiment.why}.`, parent);
    const rows = result.candidates.filter((c, k) => k < 12 && (c.gain > 0 || result.chosen.includes(c.name)));
    make("h3", "Candidates", parent);
    const found = table(["candidate", "equation", "probability", "size", "smallest detectable", ""], rows.map(c => {
      const [size] = Object.values(c.parameters);
      const button = make("button", "Add…");
      button.type = "button";
      button.setAttribute("aria-label", `Add ${words(c.name)}`);
      button.onclick = () => act(c.name);
      const of = size ? ` ${unit(size.unit)}`.trimEnd() : "";
      return [words(c.name), words(c.equation), Number(c.probability.toFixed(2)), size ? `${number(size.value)} ± ${number(Number(size.sd.toPrecision(2)))}${of}` : "",
        c.minimum_detectable === null ? "" : `${number(Number(c.minimum_detectable.toPrecision(2)))}${of}`, c.why_not || button];
    }), parent);
    [...found.tBodies[0].rows].forEach((row, k) => row.classList.toggle("chosen", result.chosen.includes(rows[k].name)));
    if (result.unknown_shape)
      make("p", `The shape of what is missing, against ${result.unknown_shape.against}, is the first picture of the report.`, parent);
    for (const channel of Object.keys(result.error.before))
      bars(`Error of ${channel} on blocks of time held out, ${UNITS[channel] || ""}`, [
        ["base model", result.error.before[channel]], ["with what was named", result.error.after[channel]],
        ["noise floor", result.error.noise_floor[channel], true]], parent);
    for (const text of result.cannot_tell) make("p", text, parent, "note");
  },

  add(result, parent) {
    for (const channel of Object.keys(result.noise_floor))
      bars(`Error of ${channel} on blocks of time held out, ${UNITS[channel] || ""}`,
        [...result.ladder.map(rung => [rungName(rung), rung.held_out[channel]]), ["noise floor", result.noise_floor[channel], true]], parent);
    const judged = Object.keys(result.ladder[result.ladder.length - 1].judged || {});
    if (judged.length) {
      make("h3", "On the recordings to judge by, run freely, rms", parent);
      table(["model", ...judged.map(c => `${c}, ${UNITS[c] || ""}`)], result.ladder.map(rung => [rungName(rung), ...judged.map(c => rung.judged[c])]), parent);
    }
    make("h3", "Parameters", parent);
    table(["parameter", "value", "standard deviation", "unit"], Object.entries(result.parameters).map(([key, p]) =>
      [key, p.value, p.sd === null ? "" : Number(p.sd.toPrecision(2)), unit(p.unit)]), parent);
  },

  // Every motor file that was compared with the same recordings, the oldest first.
  again(results, parent) {
    const channels = Object.entries(results[results.length - 1].channels);
    for (const [channel, last] of channels)
      bars(`Error of ${channel}, run freely, ${unit(last.unit)}`, [
        ...results.map(r => [r.motor, r.channels[channel] ? r.channels[channel].rmse : null]),
        ["noise floor", last.noise_floor, true]], parent);
  },
};
