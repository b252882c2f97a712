// What is said and drawn of single states: colours, letters, arrows, the greedy way, and all numbers of one.

// Colours: how large a number is beside all there are, at any moment, so that they stay while time moves.
function rangeOf(c, tables, m) {
  const { state, scene } = c;
  const n = scene.states.length;
  const skip = new Set([...scene.terminal, ...scene.unreachable]);
  const view = viewOf(c, tables, m).view;
  const gradient = (from, to) => `linear-gradient(90deg, ${from}, ${to})`;
  const pale = "var(--faint)";
  if (state.colour === "visits") {
    let most = 1;
    for (let s = 0; s < n; s++) most = Math.max(most, total(tables.visits(view, tables.moments - 1, s)));
    return {
      colour: "--ramp",
      share: (s, q, visits) => (visits ? Math.log1p(total(visits)) / Math.log1p(most) : NaN),
      bar: gradient(pale, tint("--ramp", 1)),
      words: `0 to ${count(Math.round(most))} visits (logarithmic).`,
    };
  }
  if (c.methods[m].data.policy)
    return {
      colour: "--ramp",
      share: (s, q) => worth(q),
      bar: gradient(pale, tint("--ramp", 1)),
      words: "The number is how probable the likeliest action is: 0 to 1.",
    };
  let low = 0;
  let high = 0;
  const see = (v) => Number.isFinite(v) && ((low = Math.min(low, v)), (high = Math.max(high, v)));
  for (let s = 0; s < n; s++) {
    if (skip.has(s)) continue;
    if (c.exact) see(worth(c.exactOf(s)));
    else for (let r = 0; r < tables.moments; r++) see(worth(tables.q(view, r, s)));
  }
  if (!c.exact && 20 * high < -low) high = 0; // no sign of its own: a cost that was learned overshoots 0 a little
  const span = Math.max(high, -low) || 1;
  if (state.colour === "error")
    return {
      colour: "--warm",
      share: (s, q) => Math.min(1, Math.abs(worth(q) - worth(c.exactOf(s))) / span),
      bar: gradient(pale, tint("--warm", 1)),
      words: `The number is how far the value is from the exact one; colours go from 0 to ±${short(span)}.`,
    };
  const share = (s, q) => Math.max(-1, Math.min(1, worth(q) / span));
  if (low < 0 && high > 0)
    return {
      colour: "--ramp",
      share,
      bar: gradient(`${tint("--warm", 1)}, ${pale}`, tint("--ramp", 1)),
      words: `−${short(span)} to ${short(span)}.`,
    };
  if (low < 0)
    return {
      colour: "--ramp",
      share: (s, q) => Math.abs(share(s, q)),
      bar: gradient(pale, tint("--ramp", 1)),
      words: `0 to −${short(span)} and below.`,
    };
  return {
    colour: "--ramp",
    share: (s, q) => Math.abs(share(s, q)),
    bar: gradient(pale, tint("--ramp", 1)),
    words: `0 to ${short(span)} and above.`,
  };
}

const total = (visits) => (visits ? visits.reduce((a, b) => a + b, 0) : 0);
const visitsText = (visits) =>
  visits ? (total(visits) >= 10000 ? `${Math.round(total(visits) / 1000)}k` : count(Math.round(total(visits)))) : "";

// How large numbers are in a cell that is so many pixels wide, and how many characters there is room for.
function typeIn(width) {
  const size = Math.min(12.5, Math.max(8.5, width / 3.3));
  return { size, room: Math.floor(width / (0.65 * size)) };
}

// A number in at most so many characters: with fewer decimals, then without the zero before them; or none.
function tight(v, room) {
  if (!Number.isFinite(v)) return fixed(v, 0);
  for (let decimals = Math.abs(v) < 0.995 ? 2 : Math.abs(v) < 99.5 ? 1 : 0; decimals >= 0; decimals--)
    for (const text of [fixed(v, decimals), fixed(v, decimals).replace(/^(−?)0\./, "$1.")])
      if (text.length <= room) return text;
  return "";
}
const SURE = 0.9; // of the seeds

// One letter for each action, and what they stand for.
function lettersOf(names) {
  const first = names.map((name) => name[0].toUpperCase());
  const letters = new Set(first).size === names.length ? first : names.map((_, a) => String(a));
  letters.words = names.every((name, a) => name === letters[a])
    ? ""
    : ` ${names.map((name, a) => `${letters[a]}: ${name}`).join(", ")}.`;
  return letters;
}

function arrowsPath({ x, y }, moves, several) {
  let d = "";
  for (const [down, right] of moves) {
    const size = Math.hypot(down, right) || 1;
    const dx = right / size;
    const dy = down / size;
    const length = several ? 13 : 15;
    const back = several ? 0 : -length / 2;
    const cy = y - 6;
    const hx = x + dx * (length + back);
    const hy = cy + dy * (length + back);
    if (!down && !right) d += `M${x - 4} ${cy}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0`;
    else
      d += `M${x + dx * back} ${cy + dy * back}L${hx} ${hy}M${hx - dx * 5 - dy * 5} ${hy - dy * 5 + dx * 5}L${hx} ${hy}L${hx - dx * 5 + dy * 5} ${hy - dy * 5 - dx * 5}`;
  }
  return d;
}

// The greedy way from each start, of several greedy actions by the one that ends soonest. There are none where there
// are many starts, or where nothing ends.
const MOST_STARTS = 4;

function greedyWays(c, greedy) {
  const { scene } = c;
  const next = scene.grid.next;
  const terminal = new Set(scene.terminal);
  const n = scene.states.length;
  const steps = new Float64Array(n).fill(Infinity);
  const best = Array.from({ length: n }, (_, s) => greedy(s));
  for (const s of terminal) steps[s] = 0;
  for (let changed = true; changed;) {
    changed = false;
    for (let s = 0; s < n; s++)
      if (!terminal.has(s))
        for (const a of best[s])
          if (steps[next[s][a]] + 1 < steps[s]) ((steps[s] = steps[next[s][a]] + 1), (changed = true));
  }
  const way = (s) => {
    const states = [s];
    const seen = new Set();
    while (!terminal.has(s) && !seen.has(s) && best[s].length) {
      seen.add(s);
      s = best[s].map((a) => next[s][a]).reduce((p, q) => (steps[q] < steps[p] ? q : p));
      states.push(s);
    }
    return { states, ends: terminal.has(s) };
  };
  const ends = scene.terminal.some((s) => !scene.unreachable.includes(s));
  return ends && scene.start.length <= MOST_STARTS ? scene.start.map(way) : [];
}

function waysInWords(ways, stochastic) {
  const arrive = ways.filter((way) => way.ends);
  if (arrive.length < ways.length)
    return ways.length === 1
      ? "the greedy way does not arrive"
      : `of ${ways.length} greedy ways ${ways.length - arrive.length} do not arrive`;
  const lengths = arrive.map((way) => way.states.length - 1);
  const [least, most] = [Math.min(...lengths), Math.max(...lengths)];
  const takes = ways.length === 1 ? "the greedy way takes" : "the greedy ways take";
  return `${takes} ${least === most ? least : `${least} to ${most}`} steps${stochastic ? " by the likeliest outcomes" : ""}`;
}

function nameOf(c, s) {
  for (const panel of c.scene.panels)
    for (const [i, row] of panel.states.entries()) {
      const k = row.indexOf(s);
      if (k < 0) continue;
      if (c.scene.grid) return `row ${i}, column ${k}`;
      return [panel.title, `${panel.down || "row"} ${panel.rows[i]}`, `${panel.along || "column"} ${panel.columns[k]}`]
        .filter(Boolean)
        .join(", ");
    }
  return `state ${c.scene.states[s]}`;
}

// Q of each action beside q*, and N, of the state that is looked at; of a policy how probable each action is.
function cellTable(c, box, tables, m, view, moment) {
  const { policy } = c.methods[m].data;
  const { scene, state } = c;
  const s = state.cell;
  const q = tables.q(view, moment, s);
  const best = tables.greedy(view, moment, s);
  const visits = tables.visits(view, moment, s);
  box.replaceChildren();
  const name = nameOf(c, s);
  el(
    "h6",
    {},
    box,
    sentence(name) +
      (scene.grid?.walls.includes(s)
        ? ": a wall"
        : scene.terminal.includes(s)
          ? ": an episode ends here"
          : scene.unreachable.includes(s)
          ? " (out of reach from the start)"
          : ""),
  );
  if (scene.terminal.includes(s)) return;
  const table = el("table", {}, el("div", { class: "wide" }, box));
  const head = el("tr", {}, el("thead", {}, table));
  const body = el("tbody", {}, table);
  const several = view === "mean" || view === "median";
  const columns = [[policy ? "probability" : "learned", (a) => fixed(q[a], tables.decimals)]];
  if (c.exact && !policy)
    columns.push(
      ["exact", (a) => fixed(c.exactOf(s)[a], tables.decimals)],
      ["difference", (a) => fixed(q[a] - c.exactOf(s)[a], tables.decimals)],
    );
  if (visits && q.length > 1) columns.push(["times taken", (a) => fixed(visits[a], several ? 1 : 0)]);
  el("th", { scope: "col" }, head, q.length > 1 ? "action" : "");
  for (const [text] of columns) el("th", { scope: "col" }, head, text);
  (q.length > 1 ? scene.actions : ["V"]).forEach((action, a) => {
    const row = el("tr", { class: q.length > 1 && best.includes(a) ? "best" : "" }, body);
    el("th", { scope: "row" }, row, action);
    for (const [text, value] of columns) el("td", { "data-of": text }, row, value(a));
  });
  if (!several || q.length < 2 || best.length === q.length) return;
  const share = Math.round(100 * tables.agree(view, moment, s));
  el("p", { class: "soft small" }, box, `In bold what ${share}% of these seeds would do.`);
}
