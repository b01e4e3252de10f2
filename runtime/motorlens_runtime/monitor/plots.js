"use strict";
// One uPlot for each quantity, with linked time axes and cursor: estimate, two standard deviations, limits, doubt.
const ESTIMATE = 1, LOW = 2, HIGH = 3, DEAD = 4;

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// What uPlot draws of one quantity: bad rows stand apart, and where rows are missing the line is broken.
function columns(data, k, output) {
  const times = data.time, scale = factor(output), found = [[], [], [], [], []], doubt = [];
  const step = times.length > 1 ? (times[times.length - 1] - times[0]) / (times.length - 1) : 1;
  const widest = Math.max(5 * step, 0.5);
  times.forEach((t, j) => {
    if (j && t - times[j - 1] > widest) {
      found[0].push((t + times[j - 1]) / 2);
      for (const column of found.slice(1)) column.push(null);
      doubt.push(0);
    }
    const value = data.values[k][j], bad = data.doubt[j] === 2, there = value !== null && value !== undefined;
    const band = there && !bad ? 2 * (data.sigma[k][j] || 0) * scale : null;
    found[0].push(t);
    found[ESTIMATE].push(there && !bad ? value * scale : null);
    found[LOW].push(band === null ? null : value * scale - band);
    found[HIGH].push(band === null ? null : value * scale + band);
    found[DEAD].push(there && bad ? value * scale : null);
    doubt.push(data.doubt[j]);
  });
  return {found, doubt};
}

class Plot {
  // `seen` says what is to be drawn: {limits}; `zoomed(from, to)` is told when the user has chosen a part.
  constructor(place, output, seen, zoomed, pointed) {
    Object.assign(this, {place, output, seen, doubt: [], range: null, data: [[], [], [], [], []]});
    this.make(zoomed, pointed);
    new ResizeObserver(() => this.plot.setSize({width: Math.max(place.clientWidth, 80), height: place.clientHeight})).observe(place);
  }

  make(zoomed, pointed) {
    const axis = {stroke: () => colour("faded"), grid: {stroke: () => colour("faint"), width: 1}, ticks: {show: false}, font: "12px system-ui, sans-serif"};
    const line = (name, more) => ({scale: "y", stroke: () => colour(name), points: {show: false}, spanGaps: false, ...more});
    this.plot = new uPlot({
      width: Math.max(this.place.clientWidth, 80), height: this.place.clientHeight,
      legend: {show: false}, padding: [6, 30, 0, 0],
      cursor: {sync: {key: "motorlens"}, drag: {x: true, y: true, uni: 24, setScale: false}, points: {show: false}, y: false},
      scales: {x: {time: true, range: () => this.span || [0, 1]}, y: {range: () => this.range || this.ruled()}},
      axes: [{...axis, space: 90, size: 26, values: (plot, splits) => splits.map(clock)}, {...axis, space: 24, size: 58}],
      series: [
        {}, line("predicted", {width: 1.6}), line("predicted", {width: 0}), line("predicted", {width: 0}),
        line("noise", {width: 1.4, dash: [4, 4]}),
      ],
      bands: [{series: [HIGH, LOW], fill: () => `color-mix(in srgb, ${colour("predicted")} 22%, transparent)`}],
      hooks: {
        setSelect: [plot => {
          const {left, top, width, height} = plot.select;
          plot.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
          if (width < 5 && height < 5) return;
          const whole = size => size < 5;
          const x = whole(width) ? this.span : [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
          const tall = plot.over.clientHeight;
          if (!whole(height) && height < tall - 1) this.range = [plot.posToVal(top + height, "y"), plot.posToVal(top, "y")];
          zoomed(...x);
        }],
        setCursor: [plot => pointed(this, plot.cursor.idx)],
        draw: [plot => this.marks(plot)],
      },
    }, this.data, this.place);
    this.plot.over.ondblclick = () => zoomed(null);
  }

  // The values rule the axis, not a band that is wide while nothing is known: it may take as much room again as they do.
  ruled() {
    const [times, values, lows] = this.data, [begin, end] = this.span || [0, 1];
    let low = Infinity, high = -Infinity;
    const bands = [];
    values.forEach((v, j) => {
      if (v === null || times[j] < begin || times[j] > end) return;
      low = Math.min(low, v);
      high = Math.max(high, v);
      bands.push(v - lows[j]);
    });
    if (low > high) return [0, 1];
    bands.sort((a, b) => a - b);
    const usual = bands[Math.floor(bands.length / 2)] || 0;
    const least = Math.max(Math.abs(low), Math.abs(high)) * 1e-3 || 1e-3;
    const room = Math.max(0.08 * (high - low), Math.min(1.15 * usual, Math.max(high - low, 0.05 * (this.output.scale || 0) * factor(this.output))), least);
    return [low - room, high + room];
  }

  // Limits as lines with their number; under the plot, where the quality was doubtful or bad.
  marks(plot) {
    const pen = plot.ctx, {left, top, width, height} = plot.bbox, ratio = devicePixelRatio || 1;
    pen.save();
    for (const limit of this.seen.limits.filter(one => one.heading === this.output.heading)) {
      const at = plot.valToPos(limit.limit * factor(this.output), "y", true);
      if (at < top || at > top + height) continue;
      pen.strokeStyle = pen.fillStyle = colour("bad");
      pen.lineWidth = ratio;
      pen.setLineDash([6 * ratio, 4 * ratio]);
      pen.beginPath();
      pen.moveTo(left, at);
      pen.lineTo(left + width, at);
      pen.stroke();
      pen.font = `${12 * ratio}px system-ui, sans-serif`;
      pen.textAlign = "left";
      pen.textBaseline = at - top < 18 * ratio ? "top" : "bottom";
      pen.fillText(`${limit.side > 0 ? "limit" : "at least"} ${figures(limit.limit * factor(this.output))}`, left + 4 * ratio, at);
    }
    const times = this.data[0];
    this.doubt.forEach((code, j) => {
      if (!code) return;
      const from = plot.valToPos(times[j], "x", true), to = j + 1 < times.length ? plot.valToPos(times[j + 1], "x", true) : from;
      const begin = Math.max(from, left), end = Math.min(Math.max(to, from + 2 * ratio), left + width);
      if (end <= begin) return;
      pen.fillStyle = colour(code === 2 ? "bad" : "doubt");
      pen.fillRect(begin, top + height - 4 * ratio, end - begin, 4 * ratio);
    });
    pen.restore();
  }

  draw(data, k, span) {
    const {found, doubt} = columns(data, k, this.output);
    this.data = found;
    this.doubt = doubt;
    this.span = span;
    this.plot.setData(found, false);
    this.plot.setScale("x", {min: span[0], max: span[1]});
  }

  again() {
    this.plot.redraw(true, true);
  }
}
