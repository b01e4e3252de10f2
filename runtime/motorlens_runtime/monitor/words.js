"use strict";
// Numbers, units and times as people read them, and a few lines that make elements.

// As many digits as two standard deviations leave meaning to, and one more; three where there is no deviation.
function number(value, sd) {
  if (value === null || value === undefined || Number.isNaN(value)) return "-";
  const digits = sd > 0 && isFinite(sd) ? Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(2 * sd)))) : 3;
  return value.toFixed(digits).replace(/^-0(\.0*)?$/, "0$1");
}

// Four figures, without noughts at the end: for what has no deviation.
function figures(value) {
  return value === null || value === undefined ? "-" : String(Number(value.toPrecision(4)));
}

// Speed is shown in rad/s or in rpm; everything else in its own unit.
function factor(output) {
  return output.unit === "rad/s" && rpm ? 30 / Math.PI : 1;
}

function unit(output) {
  if (output.unit === "rad/s" && rpm) return "rpm";
  return {ohm: "Ω", degC: "°C"}[output.unit] || output.unit;
}

function duration(seconds) {
  if (seconds < 100) return `${seconds < 10 ? Number(seconds.toFixed(1)) : Math.round(seconds)} s`;
  if (seconds < 6000) return `${Number((seconds / 60).toFixed(1))} min`;
  return `${Number((seconds / 3600).toFixed(1))} h`;
}

function clock(seconds) {
  return new Date(seconds * 1000).toLocaleTimeString([], {hour12: false});
}

function make(tag, text, parent, kind) {
  const element = document.createElement(tag);
  element.textContent = text;
  if (kind) element.className = kind;
  parent.append(element);
  return element;
}

// Only what has changed is written, so that text can be selected and a screen reader does not repeat itself.
function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function fill(parent, tag, rows) {
  while (parent.childElementCount > rows.length) parent.lastElementChild.remove();
  while (parent.childElementCount < rows.length) make(tag, "", parent);
  rows.forEach((text, k) => put(parent.children[k], text));
}
