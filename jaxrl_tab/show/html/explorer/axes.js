// Axes: linear, logarithmic, and logarithmic for numbers below zero, which are mirrored.

function scaleOf(kind, values, least) {
  const seen = values.filter(Number.isFinite);
  let low = seen.length ? seen.reduce((a, b) => Math.min(a, b)) : 0;
  let high = seen.length ? seen.reduce((a, b) => Math.max(a, b)) : 1;
  const same = low === high;
  if (same) [low, high] = [low - (Math.abs(low) || 1) / 2, high + (Math.abs(high) || 1) / 2];
  const wide = (a, b) => a > 0 && (kind === "log" || (kind === "auto" && b / a > 8));
  if (!same && wide(low, high)) return { kind: "log", low, high, warp: Math.log10 };
  if (!same && wide(-high, -low)) return { kind: "minus", low, high, warp: (y) => -Math.log10(-y) };
  if (least !== undefined && low >= least) low = Math.min(low, least);
  return { kind: "linear", low, high, warp: (y) => y };
}

function niceTicks(low, high, n) {
  const raw = (high - low) / n;
  const power = 10 ** Math.floor(Math.log10(raw));
  const lead = raw / power;
  const step = (lead > 5 ? 10 : lead > 2 ? 5 : lead > 1 ? 2 : 1) * power;
  const ticks = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-9; v += step) ticks.push(+v.toPrecision(12));
  return ticks;
}

function logTicks(low, high) {
  const ticks = [];
  for (let k = Math.floor(Math.log10(low)) - 1; k <= Math.log10(high) + 1; k++)
    for (const lead of [1, 2, 5]) {
      const v = +(lead * 10 ** k).toPrecision(12);
      if (v >= low * 0.999 && v <= high * 1.001) ticks.push(v);
    }
  if (ticks.length < 3) return niceTicks(low, high, 4).filter((v) => v > 0);
  return ticks.length > 9 ? ticks.filter((v) => String(v.toExponential())[0] === "1") : ticks;
}

function ticksOf(scale, n) {
  if (scale.kind === "log") return logTicks(scale.low, scale.high);
  if (scale.kind === "minus") return logTicks(-scale.high, -scale.low).map((v) => -v);
  return niceTicks(scale.low, scale.high, n);
}

let charts = 0;

// The frame of a chart: `x` and `y` give places, `plot` is what is cut off at its edges. `tells` says in words what a
// reader sees in it.
function frame(box, label, { height, x, y, xName, xTicks, yName, left, yTicks, tells }) {
  box.replaceChildren();
  el("p", { class: "axis-name", "aria-hidden": "true" }, box, yName);
  const W = Math.max(260, box.clientWidth);
  const x0 = left || 56;
  const x1 = W - 24;
  const y0 = height - 44;
  const y1 = 12;
  const id = `chart-${charts++}`;
  const said = { role: "group", "aria-labelledby": `${id}-title`, "aria-describedby": `${id}-desc` };
  const svg = el("svg", { viewBox: `0 0 ${W} ${height}`, width: W, height, ...said }, box);
  el("title", { id: `${id}-title` }, svg, label);
  el("desc", { id: `${id}-desc` }, svg, tells);
  const ticks = el("g", { "aria-hidden": "true" }, svg);
  const a = y.warp(y.low);
  const b = y.warp(y.high);
  const pad = 6;
  const atY = (v) => (Number.isFinite(v) ? y0 - pad - ((y0 - y1 - 2 * pad) * (y.warp(v) - a)) / (b - a || 1) : NaN);
  // Where the end of a band lies, which may be infinite, or zero where an axis has none: beyond the edge.
  const edge = (v) => {
    if (v === -Infinity || (y.kind === "log" && v <= 0)) return height + 100;
    return v === Infinity || (y.kind === "minus" && v >= 0) ? -100 : atY(v);
  };
  const c = x.warp(x.low);
  const d = x.warp(x.high);
  const margin = x.margin || 0;
  const atX = (v) => x0 + margin + ((x1 - x0 - 2 * margin) * (x.warp(v) - c)) / (d - c || 1);
  for (const v of yTicks || ticksOf(y, 5)) {
    el("line", { class: "grid", x1: x0, x2: x1, y1: atY(v), y2: atY(v) }, ticks);
    el(
      "text",
      { class: "tick", x: x0 - 7, y: atY(v) + 4, "text-anchor": "end" },
      ticks,
      y.text ? y.text(v) : minus(String(v)),
    );
  }
  let end = -Infinity;
  for (const [v, text] of xTicks) {
    const at = atX(v);
    const half = 4 * text.length;
    if (at - half < end) continue; // no room beside the last one
    end = at + half + 6;
    el("text", { class: "tick", x: at, y: y0 + 18, "text-anchor": "middle" }, ticks, text);
  }
  el("text", { class: "name", x: (x0 + x1) / 2, y: height - 4, "text-anchor": "middle" }, ticks, xName);
  el("line", { class: "axis", x1: x0, x2: x1, y1: y0, y2: y0 }, ticks);
  el(
    "rect",
    { x: x0, y: y1 - 4, width: x1 - x0 + 6, height: y0 - y1 + 4 },
    el("clipPath", { id }, el("defs", {}, svg)),
  );
  const plot = el("g", { "clip-path": `url(#${id})` }, svg);
  return { svg, plot, W, H: height, x0, x1, y0, y1, x: atX, y: atY, edge };
}

function linePath(xs, ys) {
  let d = "";
  let pen = false;
  xs.forEach((x, i) => {
    if (Number.isFinite(ys[i])) d += `${pen ? "L" : "M"}${x.toFixed(1)} ${ys[i].toFixed(1)}`;
    pen = Number.isFinite(ys[i]);
  });
  return d;
}

function bandPath(xs, low, high) {
  let d = "";
  let run = [];
  const flush = () => {
    const edge = (of, places) => places.map((i) => `${xs[i].toFixed(1)} ${of[i].toFixed(1)}`).join("L");
    if (run.length > 1) d += `M${edge(high, run)}L${edge(low, [...run].reverse())}Z`;
    run = [];
  };
  xs.forEach((_, i) => (Number.isFinite(low[i]) && Number.isFinite(high[i]) ? run.push(i) : flush()));
  flush();
  return d;
}

const DASHES = ["", "8 4", "2 4", "10 4 2 4"];
const [DASHED, DOTTED] = ["5 4", "2 3"]; // of lines that are exact
const COLOURS = 7; // much as in the pictures, but all with contrast enough: `page.css` has them
const colourOf = (i) => `var(--c${i % COLOURS})`;
const dashOf = (i) => DASHES[i % DASHES.length];

// A line with its mark, as a legend has it.
function swatch(parent, colour, dash, i) {
  const box = el("svg", { viewBox: "0 0 34 12", width: 34, height: 12, "aria-hidden": "true" }, parent);
  const style = { stroke: colour };
  el("line", { class: "line", x1: 1, x2: 33, y1: 6, y2: 6, style, "stroke-dasharray": dash }, box);
  if (i !== undefined) mark(box, i, 17, 6, 4, colour);
}

// A mark for each number, of different shapes.
function mark(parent, i, x, y, r, colour) {
  const d = [
    `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0Z`,
    `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}Z`,
    `M${x} ${y - r * 1.2}l${r * 1.2} ${r * 2.1}h${-r * 2.4}Z`,
    `M${x} ${y - r * 1.3}l${r * 1.3} ${r * 1.3}l${-r * 1.3} ${r * 1.3}l${-r * 1.3} ${-r * 1.3}Z`,
  ][i % 4];
  return el("path", { class: "mark", d, style: { fill: colour } }, parent);
}

// A colour of a scale from pale to strong, on which dark text can be read: its contrast is 4.5 or more.
const tint = (colour, share) =>
  `color-mix(in oklab, var(${colour}) ${Math.round(6 + 64 * Math.min(1, Math.max(0, share)))}%, var(--faint))`;
