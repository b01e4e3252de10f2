"use strict";
// What is on the page as a file, and a file on the page: CSV, PNG, and recordings played back.

function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

// The rows of the part that is shown, in the columns of every other CSV of motorlens; times are seconds since 1970.
function csvOf(data, span, outputs) {
  const names = outputs.flatMap(o => o.input ? [o.heading] : [o.heading, o.sd_heading]);
  const lines = [["time_s", ...names, "doubt"].join(",")];
  const text = v => v === null || v === undefined ? "" : String(v);
  data.time.forEach((t, j) => {
    if (t < span[0] || t > span[1]) return;
    const row = outputs.flatMap((o, k) => o.input ? [data.values[k][j]] : [data.values[k][j], data.sigma[k][j]]);
    lines.push([t, ...row, data.doubt[j]].map(text).join(","));
  });
  return lines.join("\n") + "\n";
}

// All plots below one another, with their names, on the page's own background.
function pngOf(plots, title) {
  const ratio = devicePixelRatio || 1, head = 26 * ratio;
  const pictures = plots.map(plot => plot.plot.ctx.canvas);
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(...pictures.map(picture => picture.width));
  canvas.height = pictures.reduce((sum, picture) => sum + picture.height + head, head);
  const pen = canvas.getContext("2d");
  pen.fillStyle = colour("paper");
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.fillStyle = colour("ink");
  pen.font = `${13 * ratio}px system-ui, sans-serif`;
  pen.textBaseline = "middle";
  pen.fillText(title, 8 * ratio, head / 2);
  let top = head;
  pictures.forEach((picture, k) => {
    pen.fillText(`${plots[k].output.name}, ${unit(plots[k].output)}`, 8 * ratio, top + head / 2);
    pen.drawImage(picture, 0, top + head);
    top += picture.height + head;
  });
  return new Promise(done => canvas.toBlob(done, "image/png"));
}

// Rows of a CSV that this page, `motorlens run` or `infer` has written; throws a line that says what is wrong.
function readCsv(text, {outputs, bad_word, throughout_word}) {
  const lines = text.split(/\r?\n/).filter(line => line && !line.startsWith("#"));
  const names = (lines.shift() || "").split(",").map(name => name.trim());
  const at = name => names.indexOf(name);
  if (at("time_s") < 0) throw new Error("has no column time_s; open a CSV that this page, motorlens run or motorlens infer has written");
  if (!outputs.some(o => at(o.heading) >= 0)) throw new Error(`has none of the columns ${outputs.map(o => o.heading).join(", ")}`);
  const data = {time: [], values: outputs.map(() => []), sigma: outputs.map(() => []), doubt: []};
  const cell = (row, k) => k < 0 || row[k] === undefined || row[k] === "" || !isFinite(row[k]) ? null : Number(row[k]);
  for (const line of lines) {
    const row = line.split(","), t = cell(row, at("time_s"));
    if (t === null) continue;
    data.time.push(t);
    outputs.forEach((o, k) => {
      data.values[k].push(cell(row, at(o.heading)));
      data.sigma[k].push(o.input ? 0 : cell(row, at(o.sd_heading)));
    });
    const word = cell(row, at("quality")) || 0;
    data.doubt.push(at("doubt") >= 0 ? cell(row, at("doubt")) || 0 : word & bad_word ? 2 : word & ~throughout_word ? 1 : 0);
  }
  if (!data.time.length) throw new Error("has a heading and no rows");
  return data;
}
