// What was learned about the states: a grid, panels, or a list, at a moment.

function sceneCard(c) {
  const { section, controls, body } = card(c.root, "What was learned", "learned"), { state } = c;
  const colour = select(controls, "colour", [], (v) => c.set({ colour: v }));
  const beside = select(controls, "beside it", [], (v) => c.set({ beside: +v }));
  const note = el("p", { class: "note" }, section);
  const inPanels = c.scene.panels.length > 0;
  let stages = [], wanted = 0;

  async function draw() {
    const turn = ++wanted, shown = [state.method, state.beside].filter((m) => m >= 0 && m < c.methods.length);
    const tables = await Promise.all(shown.map((m) => c.tables(m)));
    if (turn !== wanted) return;  // something else was chosen meanwhile
    const colours = [["value", "value"], ...(c.exact ? [["error", "distance from what is exact"]] : []), ...(tables.some((t) => t && t.visits("mean", 0, 0)) ? [["visits", "visits"]] : [])];
    colour.fill(inPanels ? colours : []);
    colour.show(state.colour);
    if (colour.box.selectedIndex < 0) colour.show((state.colour = "value"));
    beside.fill([[-1, "nothing"], ...c.methods.map((m, i) => [i, m.data.title]).filter(([i]) => i !== state.method)]);
    beside.show(shown.length > 1 ? state.beside : -1);
    body.replaceChildren();
    body.classList.toggle("two", shown.length > 1);
    stages = shown.map((m, i) => (inPanels ? panelStage : listStage)(c, el("div", { class: "stage" }, body), m, tables[i]));
    c.root.dataset.tables = shown.map((m) => `${m}-${c.settingOf(m)}`).join(",");
    move();
  }

  function move() {
    stages.forEach((stage) => stage.move());
    const { missing, best, tables } = c.methods[state.method].data;
    const other = tables[best].moments > 1 && c.settingOf(state.method) !== best;
    note.textContent = missing ? `These are the tables at the end: ${missing}` : other ? "Tables over time are kept of the best setting (★) of each method." : "";
  }

  return { draw, move, cell: () => stages.forEach((stage) => stage.cell()) };
}

// The view that is shown of a table, its moment, and what to say of both.
function viewOf(c, tables, m) {
  const method = c.methods[m], wanted = c.state.view, view = tables.has(wanted) ? wanted : tables.has("middle") ? "middle" : tables.views[0];
  const moment = tables.moments > 1 ? method.pointAt(c.time()) : 0;
  const at = tables.moments > 1 ? `after ${count(method.data.x[moment])} ${c.data.unit}` : "at the end of the runs";
  const of = view === "mean" || view === "median" ? `${view} of ${tables.averaged < method.data.seeds ? `the first ${tables.averaged} of ` : ""}${method.data.seeds} seeds` : method.seedName(c.settingOf(m), view);
  return { view, moment, words: `${of}, ${at}` };
}

function titleOf(c, box, m) {
  const method = c.methods[m], head = el("h5", {}, box);
  el("span", { class: "dot", style: { background: colourOf(m) } }, head);
  el("span", {}, head, [method.data.title, method.inWords(c.settingOf(m))].filter(Boolean).join(", "));
  return el("p", { class: "soft small" }, box);
}

// The largest value of a row of a table: what a state is worth.
function worth(q) {
  let v = NaN;
  for (const x of q) if (!Number.isNaN(x) && !(x <= v)) v = x;
  return v;
}

function panelStage(c, box, m, tables) {
  const { scene, state } = c, words = titleOf(c, box, m);
  if (!tables) return (words.textContent = "Of this setting there is no table in this page: results.nc has it.", { move() {}, cell() {} });
  const grid = scene.grid, size = grid ? 64 : 46, left = grid ? 4 : 44, n = scene.states.length;
  const terminal = new Set(scene.terminal), unreachable = new Set(scene.unreachable), starts = new Set(scene.start), cells = [];
  const exact = c.exact && ((s) => worth(c.exactOf(s)));
  const letters = lettersOf(scene.actions);
  for (const panel of scene.panels) {
    const rows = panel.states.length, columns = panel.columns.length, top = panel.title ? 26 : 4, below = grid ? (grid.wind.length ? 26 : 4) : 40;
    const svg = el("svg", { class: "panel", viewBox: `0 0 ${left + columns * size + 4} ${top + rows * size + below}`, role: "group", "aria-label": `${panel.title || "the states"}: arrow keys go from state to state` }, box);
    svg.style.maxWidth = `${(left + columns * size + 4) * 1.1}px`;
    const hatch = `hatch-${clips++}`, pattern = el("pattern", { id: hatch, width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, el("defs", {}, svg));
    el("line", { class: "hatch", x1: 0, y1: 0, x2: 0, y2: 7 }, pattern);
    if (panel.title) el("text", { class: "title", x: left, y: 17 }, svg, panel.title);
    const above = el("g", { class: "above" });
    panel.states.forEach((row, i) => row.forEach((s, k) => {
      const x = left + k * size, y = top + i * size;
      const g = el("g", { class: "cell", tabindex: -1, role: "img", "data-s": s }, svg);
      const rect = el("rect", { class: "box", x, y, width: size, height: size, rx: 4 }, g);
      if (unreachable.has(s)) el("rect", { x, y, width: size, height: size, fill: `url(#${hatch})`, class: "over" }, g);
      const cell = { s, g, rect, x: x + size / 2, y: y + size / 2, i, k, panel, arrow: el("path", { class: "arrow" }, above), text: el("text", { class: "v", x: x + size / 2, y: y + size / 2 + (grid ? 24 : 17) }, above), letter: el("text", { class: "letter", x: x + size / 2, y: y + size / 2 + 1 }, above) };
      cells.push(cell);
      for (const kind of ["pointerenter", "focus", "click"]) g.addEventListener(kind, () => c.choose(s));
      g.addEventListener("keydown", (event) => {
        const step = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
        const next = step && cells.find((other) => other.panel === panel && other.i === i + step[0] && other.k === k + step[1]);
        if (!step) return;
        event.preventDefault();
        if (next) c.choose(next.s), next.g.focus();
      });
    }));
    if (grid) grid.wind.forEach((w, k) => el("text", { class: "tick", x: left + (k + 0.5) * size, y: top + rows * size + 18, "text-anchor": "middle" }, svg, (k ? "" : "wind ") + "↑".repeat(w)));
    else {
      panel.rows.forEach((name, i) => el("text", { class: "tick", x: left - 6, y: top + (i + 0.5) * size + 4, "text-anchor": "end" }, svg, name));
      panel.columns.forEach((name, k) => el("text", { class: "tick", x: left + (k + 0.5) * size, y: top + rows * size + 15, "text-anchor": "middle" }, svg, name));
      el("text", { class: "name", x: left + (columns * size) / 2, y: top + rows * size + 34, "text-anchor": "middle" }, svg, [panel.along, panel.down && `rows: ${panel.down}`].filter(Boolean).join("; "));
    }
    if (grid) cells.path = el("path", { class: "way", style: { stroke: colourOf(m) } }, svg);
    svg.append(above);
    if (grid) for (const cell of cells) {
      const badge = starts.has(cell.s) ? "S" : cell.s === grid.goal ? "G" : null;
      if (!badge) continue;
      el("circle", { class: "badge", cx: cell.x - 20, cy: cell.y - 20, r: 9 }, above);
      el("text", { class: "badge-text", x: cell.x - 20, y: cell.y - 15.5 }, above, badge);
    }
  }
  const ramp = el("p", { class: "ramp soft small" }, box), bar = el("span", { class: "bar" }, ramp), meaning = el("span", {}, ramp);
  const about = el("div", { class: "about", "aria-live": "off" }, box);
  const range = rangeOf(c, tables, m);

  function move() {
    const { view, moment, words: said } = viewOf(c, tables, m);
    words.textContent = said;
    for (const cell of cells) {
      const { s } = cell, q = tables.q(view, moment, s), v = worth(q), best = tables.greedy(view, moment, s), over = terminal.has(s);
      const untouched = q.every((x) => x === q[0]) && q.length > 1, sure = tables.agree(view, moment, s);
      const share = over ? NaN : range.share(s, q, tables.visits(view, moment, s));
      cell.rect.style.fill = Number.isNaN(share) ? "var(--card)" : tint(share < 0 ? "--warm" : range.colour, Math.abs(share));
      const shown = over ? "" : untouched && state.colour !== "visits" ? "·" : state.colour === "visits" ? visitsText(tables.visits(view, moment, s)) : state.colour === "error" ? tight(v - exact(s)) : tight(v);
      cell.text.textContent = shown;
      const arrows = grid && scene.arrows.every(Boolean);
      cell.arrow.setAttribute("d", !arrows || over || untouched ? "" : arrowsPath(cell, best.map((a) => scene.arrows[a]), best.length > 1));
      cell.letter.textContent = arrows || over || q.length < 2 || untouched ? "" : best.map((a) => letters[a]).join("");
      for (const part of [cell.arrow, cell.letter]) part.style.opacity = 0.25 + 0.75 * sure;
      const acts = q.length > 1 && !untouched ? `, ${best.map((a) => scene.actions[a]).join(" or ")}` : "";
      cell.g.setAttribute("aria-label", over ? "an episode ends here" : `${nameOf(c, s)}: ${fixed(v, c.decimals)}${acts}`);
    }
    const way = grid && tables.q(view, moment, 0).length > 1 ? greedyWay(c, (s) => tables.greedy(view, moment, s)) : null;
    if (cells.path) {
      const at = (s) => cells.find((cell) => cell.s === s);
      cells.path.setAttribute("d", way ? way.states.map((s, i) => `${i ? "L" : "M"}${at(s).x} ${at(s).y}`).join("") : "");
      cells.path.setAttribute("stroke-dasharray", way && way.ends ? "" : "2 9");
    }
    bar.style.background = range.bar;
    const faint = view === "mean" || view === "median" ? " The fainter an arrow, the fewer seeds agree." : "";
    meaning.textContent = range.words + (way ? ` The greedy way ${way.ends ? `takes ${way.states.length - 1} steps${grid.stochastic ? " by the likeliest outcomes" : ""}` : "does not arrive"}.` : "") + (grid ? faint : letters.words + (faint && " The fainter a letter, the fewer seeds agree."));
    cell();
  }

  function cell() {
    for (const one of cells) {
      one.g.classList.toggle("on", one.s === state.cell);
      one.g.setAttribute("tabindex", one.s === state.cell ? 0 : -1);
    }
    const { view, moment } = viewOf(c, tables, m);
    cellTable(c, about, tables, view, moment);
  }

  return { move, cell };
}

// Colours: how large a number is beside all there are, at any moment, so that they stay while time moves.
function rangeOf(c, tables, m) {
  const { state, scene } = c, n = scene.states.length, skip = new Set([...scene.terminal, ...scene.unreachable]);
  const view = viewOf(c, tables, m).view;
  const gradient = (from, to) => `linear-gradient(90deg, ${from}, ${to})`, pale = "var(--faint)";
  if (state.colour === "visits") {
    let most = 1;
    for (let s = 0; s < n; s++) most = Math.max(most, total(tables.visits(view, tables.moments - 1, s)));
    return { colour: "--ramp", share: (s, q, visits) => (visits ? Math.log1p(total(visits)) / Math.log1p(most) : NaN), bar: gradient(pale, tint("--ramp", 1)), words: `0 to ${count(Math.round(most))} visits (logarithmic).` };
  }
  let low = 0, high = 0;
  const see = (v) => Number.isFinite(v) && ((low = Math.min(low, v)), (high = Math.max(high, v)));
  for (let s = 0; s < n; s++) {
    if (skip.has(s)) continue;
    if (c.exact) see(worth(c.exactOf(s)));
    else for (let r = 0; r < tables.moments; r++) see(worth(tables.q(view, r, s)));
  }
  const span = Math.max(high, -low) || 1;
  if (state.colour === "error")
    return { colour: "--warm", share: (s, q) => Math.min(1, Math.abs(worth(q) - worth(c.exactOf(s))) / span), bar: gradient(pale, tint("--warm", 1)), words: `The number is how far the value is from the exact one; colours go from 0 to ±${short(span)}.` };
  const share = (s, q) => Math.max(-1, Math.min(1, worth(q) / span));
  if (low < 0 && high > 0) return { colour: "--ramp", share, bar: gradient(`${tint("--warm", 1)}, ${pale}`, tint("--ramp", 1)), words: `−${short(span)} to ${short(span)}.` };
  if (low < 0) return { colour: "--ramp", share: (s, q) => Math.abs(share(s, q)), bar: gradient(pale, tint("--ramp", 1)), words: `0 to −${short(span)} and below.` };
  return { colour: "--ramp", share: (s, q) => Math.abs(share(s, q)), bar: gradient(pale, tint("--ramp", 1)), words: `0 to ${short(span)} and above.` };
}

const total = (visits) => (visits ? visits.reduce((a, b) => a + b, 0) : 0);
const visitsText = (visits) => (visits ? (total(visits) >= 10000 ? `${Math.round(total(visits) / 1000)}k` : count(Math.round(total(visits)))) : "");
const tight = (v) => (Number.isFinite(v) ? (Math.abs(v) < 9.95 ? fixed(v, Math.abs(v) < 0.995 ? 2 : 1) : fixed(v, Math.abs(v) < 99.5 ? 1 : 0)) : fixed(v, 0));

// One letter for each action, and what they stand for.
function lettersOf(names) {
  const first = names.map((name) => name[0].toUpperCase()), letters = new Set(first).size === names.length ? first : names.map((_, a) => String(a));
  letters.words = names.every((name, a) => name === letters[a]) ? "" : ` ${names.map((name, a) => `${letters[a]}: ${name}`).join(", ")}.`;
  return letters;
}

function arrowsPath({ x, y }, moves, several) {
  let d = "";
  for (const [down, right] of moves) {
    const size = Math.hypot(down, right) || 1, dx = right / size, dy = down / size, length = several ? 13 : 15, back = several ? 0 : -length / 2, cy = y - 6;
    const hx = x + dx * (length + back), hy = cy + dy * (length + back);
    if (!down && !right) d += `M${x - 4} ${cy}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0`;
    else d += `M${x + dx * back} ${cy + dy * back}L${hx} ${hy}M${hx - dx * 5 - dy * 5} ${hy - dy * 5 + dx * 5}L${hx} ${hy}L${hx - dx * 5 + dy * 5} ${hy - dy * 5 - dx * 5}`;
  }
  return d;
}

// The greedy way from the start: of several greedy actions the one that ends soonest.
function greedyWay(c, greedy) {
  const { scene } = c, next = scene.grid.next, terminal = new Set(scene.terminal), n = scene.states.length;
  const steps = new Float64Array(n).fill(Infinity), best = Array.from({ length: n }, (_, s) => greedy(s));
  for (const s of terminal) steps[s] = 0;
  for (let changed = true; changed; ) {
    changed = false;
    for (let s = 0; s < n; s++)
      if (!terminal.has(s)) for (const a of best[s]) if (steps[next[s][a]] + 1 < steps[s]) (steps[s] = steps[next[s][a]] + 1), (changed = true);
  }
  let s = scene.start[0];
  const states = [s], seen = new Set();
  while (!terminal.has(s) && !seen.has(s) && best[s].length) {
    seen.add(s);
    s = best[s].map((a) => next[s][a]).reduce((p, q) => (steps[q] < steps[p] ? q : p));
    states.push(s);
  }
  return { states, ends: terminal.has(s) };
}

function nameOf(c, s) {
  for (const panel of c.scene.panels)
    for (const [i, row] of panel.states.entries()) {
      const k = row.indexOf(s);
      if (k < 0) continue;
      if (c.scene.grid) return `row ${i}, column ${k}`;
      return [panel.title, `${panel.down || "row"} ${panel.rows[i]}`, `${panel.along || "column"} ${panel.columns[k]}`].filter(Boolean).join(", ");
    }
  return `state ${c.scene.states[s]}`;
}

// Q of each action beside q*, and N, of the state that is looked at.
function cellTable(c, box, tables, view, moment) {
  const { scene, state } = c, s = state.cell, q = tables.q(view, moment, s), best = tables.greedy(view, moment, s), visits = tables.visits(view, moment, s);
  box.replaceChildren();
  const name = nameOf(c, s);
  el("h6", {}, box, name[0].toUpperCase() + name.slice(1) + (scene.terminal.includes(s) ? ": an episode ends here" : scene.unreachable.includes(s) ? " (out of reach from the start)" : ""));
  if (scene.terminal.includes(s)) return;
  const table = el("table", {}, el("div", { class: "wide" }, box)), head = el("tr", {}, el("thead", {}, table)), body = el("tbody", {}, table);
  const of = q.length > 1 ? scene.actions : ["V"], rows = [["learned", (a) => fixed(q[a], tables.decimals)]];
  if (c.exact) rows.push(["exact", (a) => fixed(c.exactOf(s)[a], tables.decimals)], ["difference", (a) => fixed(q[a] - c.exactOf(s)[a], tables.decimals)]);
  if (visits && q.length > 1) rows.push(["times taken", (a) => fixed(visits[a], view === "mean" || view === "median" ? 1 : 0)]);
  el("th", { scope: "col" }, head, q.length > 1 ? "action" : "");
  of.forEach((text, a) => el("th", { scope: "col", class: q.length > 1 && best.includes(a) ? "best" : "" }, head, text));
  for (const [text, value] of rows) {
    const row = el("tr", { "data-row": text }, body);
    el("th", { scope: "row" }, row, text);
    of.forEach((_, a) => el("td", { class: q.length > 1 && best.includes(a) ? "best" : "" }, row, value(a)));
  }
}

// The states as a table, for tasks that have no picture.
function listStage(c, box, m, tables) {
  const { scene } = c, words = titleOf(c, box, m);
  if (!tables) return (words.textContent = "Of this setting there is no table in this page: results.nc has it.", { move() {}, cell() {} });
  const several = tables.actions > 1, names = several ? scene.actions : ["V"], wide = el("div", { class: "wide list", tabindex: 0, role: "region", "aria-label": "states" }, box);
  const table = el("table", {}, wide), head = el("tr", {}, el("thead", {}, table)), body = el("tbody", {}, table);
  const titles = ["state", ...(several ? ["greedy"] : []), ...names.map((name) => (several ? `Q(${name})` : name)), ...(c.exact ? names.map((name) => (several ? `q*(${name})` : "exact")) : []), ...(tables.visits("mean", 0, 0) ? ["visits"] : [])];
  const many = scene.states.length * titles.length > 20000, states = scene.states.map((_, s) => s).filter((s) => !scene.terminal.includes(s) && !scene.unreachable.includes(s));
  for (const title of titles) el("th", { scope: "col" }, head, title);
  const rows = states.map((s) => {
    const row = el("tr", {}, body);
    el("th", { scope: "row" }, row, `${scene.states[s]}${scene.start.includes(s) ? " (start)" : ""}`);
    return titles.slice(1).map(() => el("td", {}, row));
  });
  if (scene.of > scene.states.length) el("p", { class: "soft small" }, box, `${scene.states.length} of ${count(scene.of)} states: where episodes start, and those whose values are the furthest from what is exact, or from 0.`);
  function move() {
    const { view, moment, words: said } = viewOf(c, tables, m);
    words.textContent = said;
    states.forEach((s, i) => {
      const q = [...tables.q(view, moment, s)], best = tables.greedy(view, moment, s), visits = tables.visits(view, moment, s);
      const texts = [...(several ? [best.length === q.length ? "any" : best.map((a) => scene.actions[a]).join(" or ")] : []), ...q.map((x) => fixed(x, tables.decimals)), ...(c.exact ? [...c.exactOf(s)].map((x) => fixed(x, tables.decimals)) : []), ...(visits ? [count(Math.round(total(visits)))] : [])];
      texts.forEach((text, k) => (rows[i][k].textContent = text));
    });
  }
  return { move, cell() {} };
}
