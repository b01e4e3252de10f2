"use strict";
// Pictures of a report that are not against time: curves, and clouds of points.
const MOST_POINTS = 20000; // of a cloud; more are a blot

// Curves over one axis: lines by name, a band, marks with a dotted line.
function drawCurves(scene, place, spec) {
  const lines = spec.lines.map(line => ({label: line.name, stroke: () => colour(line.role), width: 1.6, value: (u, v) => short(v, 4), points: {show: false}}));
  const edges = spec.band.map(() => ({label: "", stroke: "transparent", points: {show: false}, value: () => ""}));
  const dashes = [[], [8, 4], [2, 3], [10, 3, 2, 3]], seen = {};
  spec.lines.forEach((line, k) => { seen[line.role] = (seen[line.role] ?? -1) + 1; lines[k].dash = dashes[seen[line.role] % dashes.length]; });
  const n = lines.length;
  const u = scene.add({
    height: 300, axes: axes(spec.x, spec.y),
    scales: {x: spec.logarithmic ? {time: false, distr: 3} : {time: false}, y: {range: (_, low, high) => rangeOf(low, high)}},
    series: [{label: spec.x, value: (_, v) => short(v, 4)}, ...lines, ...edges],
    bands: spec.band.length ? [{series: [n + 2, n + 1], fill: () => colour("noise").replace("rgb(", "rgba(").replace(")", ", 0.35)")}] : [],
    cursor: {drag: {x: true, y: false}},
    hooks: {draw: [plot => drawMarks(plot, spec.marks)]},
  }, [spec.at, ...spec.lines.map(line => line.y), ...spec.band], place);
  if (spec.band.length) [...u.root.querySelectorAll(".u-series")].slice(n + 1).forEach(row => { row.hidden = true; });
  const wrap = u.root.querySelector(".u-wrap");
  wrap.setAttribute("role", "img");
  wrap.setAttribute("aria-label", `${spec.y} against ${spec.x}: ${spec.lines.map(line => line.name).join(", ")}`);
}

function drawMarks(u, marks) {
  const {ctx, bbox} = u, ratio = devicePixelRatio;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("faded");
  ctx.font = `${12 * ratio}px system-ui, sans-serif`;
  ctx.setLineDash([2 * ratio, 4 * ratio]);
  Object.entries(marks).sort((a, b) => a[1] - b[1]).forEach(([name, at], k) => {
    if (at < u.scales.x.min || at > u.scales.x.max) return;
    const x = u.valToPos(at, "x", true);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    const right = x + ctx.measureText(name).width + 6 * ratio > bbox.left + bbox.width;
    ctx.textAlign = right ? "right" : "left";
    ctx.fillText(name, x + (right ? -4 : 4) * ratio, bbox.top + (14 + 15 * k) * ratio); // one below the other: none covers its neighbour
  });
  ctx.restore();
}

// A point for each sample, of all recordings.
function drawCloud(scene, place, spec) {
  const groups = scene.groups.filter(group => group.lacks(spec.lacks) && group.state(spec.state));
  const roles = ["predicted", "lacking", "measured", "good", "doubt"], share = Math.floor(MOST_POINTS / Math.max(groups.length, 1));
  const clouds = groups.map(group => {
    const x = group.state(spec.state), y = group.lacks(spec.lacks), step = Math.max(1, Math.ceil(x.length / share));
    const kept = [...x.keys()].filter(k => k % step === 0 && Number.isFinite(x[k]) && Number.isFinite(y[k]));
    return [kept.map(k => x[k]), kept.map(k => y[k])];
  });
  const ends = k => rangeOf(...clouds.map(cloud => extremes(cloud[k])).reduce(([a, b], [c, d]) => [Math.min(a, c), Math.max(b, d)], [Infinity, -Infinity]));
  if (!clouds.some(cloud => cloud[0].length)) return;
  const points = (u, k) => {
    const [x, y] = u.data[k], size = 2 * devicePixelRatio, {ctx} = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    ctx.globalAlpha = 0.55;
    ctx.fillStyle = colour(roles[(k - 1) % roles.length]);
    for (let j = 0; j < x.length; j++) ctx.fillRect(u.valToPos(x[j], "x", true) - size / 2, u.valToPos(y[j], "y", true) - size / 2, size, size);
    ctx.restore();
    return null;
  };
  const u = scene.add({
    mode: 2, height: 300, axes: axes(spec.x, spec.y), legend: {show: false}, cursor: {show: false},
    scales: {x: {time: false, range: () => ends(0)}, y: {range: () => ends(1)}},
    series: [{}, ...groups.map(group => ({label: group.spec.name, paths: points, stroke: "transparent"}))],
  }, [null, ...clouds], place);
  const wrap = u.root.querySelector(".u-wrap");
  wrap.setAttribute("role", "img");
  wrap.setAttribute("aria-label", `${spec.y} against ${spec.x}, ${clouds.reduce((sum, cloud) => sum + cloud[0].length, 0)} points`);
  const thinned = groups.some(group => group.time.length > share) ? `; at most ${MOST_POINTS} points, evenly chosen` : "";
  if (groups.length > 1 || thinned) put("p", place, groups.map((group, k) => `${group.spec.name}: ${["blue", "orange", "grey", "green", "brown"][k % 5]}`).join(", ") + thinned, "note");
}
