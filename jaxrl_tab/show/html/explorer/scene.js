// What was learned about the states: a grid, panels, or a list, at a moment.

function sceneCard(c) {
  const { section, controls, body } = card(c.root, "What was learned", "learned");
  const { state } = c;
  const colour = select(controls, "colour", [], (v) => c.set({ colour: v }));
  const beside = select(controls, "beside it", [], (v) => c.set({ beside: +v }));
  const note = el("p", { class: "note" }, section);
  const inPanels = c.scene.panels.length > 0;
  let stages = [];
  let wanted = 0;

  async function draw() {
    const turn = ++wanted;
    const shown = [state.method, state.beside].filter((m) => m >= 0 && m < c.methods.length);
    const tables = await Promise.all(shown.map((m) => c.tables(m)));
    if (turn !== wanted) return; // something else was chosen meanwhile
    const colours = [
      ["value", "value"],
      ...(c.exact ? [["error", "distance from what is exact"]] : []),
      ...(tables.some((t) => t && t.visits("mean", 0, 0)) ? [["visits", "visits"]] : []),
    ];
    colour.fill(inPanels ? colours : []);
    colour.show(state.colour);
    if (colour.box.selectedIndex < 0) colour.show((state.colour = "value"));
    beside.fill([[-1, "nothing"], ...c.methods.map((m, i) => [i, m.data.title]).filter(([i]) => i !== state.method)]);
    beside.show(shown.length > 1 ? state.beside : -1);
    body.replaceChildren();
    body.classList.toggle("two", shown.length > 1);
    body.classList.toggle("broad", !inPanels && c.scene.actions.length > 3);
    stages = shown.map((m, i) =>
      (inPanels ? panelStage : listStage)(c, el("div", { class: "stage" }, body), m, tables[i]),
    );
    c.root.dataset.tables = shown.map((m) => `${m}-${c.settingOf(m)}`).join(",");
    move();
  }

  if (c.scene.places) el("p", { class: "note" }, section, c.scene.places);

  function move() {
    stages.forEach((stage) => stage.move());
    const { missing, best, tables } = c.methods[state.method].data;
    const other = tables[best].moments > 1 && c.settingOf(state.method) !== best;
    note.textContent = missing
      ? `These are the tables at the end: ${missing}`
      : other
        ? "Tables over time are kept of the best setting (★) of each method."
        : "";
  }

  const says = () =>
    stages
      .map((stage) => stage.says?.())
      .filter(Boolean)
      .join(" ");
  return { draw, move, says, cell: () => stages.forEach((stage) => stage.cell()) };
}

// The view that is shown of a table, its moment, and what to say of both.
function viewOf(c, tables, m) {
  const method = c.methods[m];
  const wanted = c.state.view;
  const view = tables.has(wanted) ? wanted : tables.has("middle") ? "middle" : tables.views[0];
  const moment = tables.moments > 1 ? method.pointAt(c.time()) : 0;
  const at = tables.moments > 1 ? `after ${count(method.data.x[moment])} ${c.data.unit}` : "at the end of the runs";
  const of =
    view === "mean" || view === "median"
      ? `${view} of ${tables.averaged < method.data.seeds ? `the first ${tables.averaged} of ` : ""}${method.data.seeds} seeds`
      : method.seedName(c.settingOf(m), view);
  return { view, moment, words: `${of}, ${at}` };
}

function titleOf(c, box, m) {
  const method = c.methods[m];
  const head = el("h5", {}, box);
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

const LEAST_NAMED = 18; // pixels of a place in which its best actions stand

function panelStage(c, box, m, tables) {
  const { scene, state } = c;
  const words = titleOf(c, box, m);
  const { policy } = c.methods[m].data;
  if (!tables)
    return (
      (words.textContent = "Of this setting there is no table in this page: results.nc has it."),
      { move() {}, cell() {} }
    );
  const grid = scene.grid;
  const size = grid ? 64 : 46;
  const longestName = (names) => Math.max(...names.map((name) => name.length));
  const n = scene.states.length;
  const terminal = new Set(scene.terminal);
  const unreachable = new Set(scene.unreachable);
  const walls = new Set(grid ? grid.walls : []);
  const cells = [];
  const exact = c.exact && ((s) => worth(c.exactOf(s)));
  const letters = lettersOf(scene.actions);
  const largest = scene.panels.length > 3 ? 0.85 : 1.1; // so that two of many are side by side
  for (const panel of scene.panels) {
    const rows = panel.states.length;
    const columns = panel.columns.length;
    const top = panel.title ? 26 : 4;
    // The narrower the picture, the larger its type beside its cells.
    const scaleOn = (wide) => Math.min(largest, (box.clientWidth || 500) / wide);
    const tick = Math.max(12, 10 / scaleOn(48 + columns * size));
    const left = grid ? 4 : Math.max(44, 10 + 0.62 * tick * longestName(panel.rows));
    const below = grid ? (grid.wind.length ? 26 : 4) : 16 + 2 * tick;
    const svg = el(
      "svg",
      {
        class: "panel",
        viewBox: `0 0 ${left + columns * size + 4} ${top + rows * size + below}`,
        role: "radiogroup",
        "aria-labelledby": `panel-${charts}-title`,
        "aria-describedby": `panel-${charts}-desc`,
      },
      box,
    );
    const wide = left + columns * size + 4;
    svg.style.maxWidth = `${wide * largest}px`;
    const scale = scaleOn(wide);
    const type = typeIn(size * scale);
    const named = !scene.places || size * scale > LEAST_NAMED;
    if (scene.places) type.room = 0; // the places of a surface have no numbers in them
    svg.style.setProperty("--number", `${type.size / scale}px`);
    svg.style.setProperty("--tick", `${tick}px`);
    const badge = Math.max(9, 6.5 / scale);
    svg.style.setProperty("--badge", `${badge * 1.35}px`);
    el("title", { id: `panel-${charts}-title` }, svg, panel.title || "The states");
    el("desc", { id: `panel-${charts}-desc` }, svg, "The arrow keys go from state to state.");
    const hatch = `hatch-${charts++}`;
    const pattern = el(
      "pattern",
      { id: hatch, width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
      el("defs", {}, svg),
    );
    el("line", { class: "hatch", x1: 0, y1: 0, x2: 0, y2: 7 }, pattern);
    if (panel.title) el("text", { class: "title", x: left, y: 17 }, svg, panel.title);
    const above = el("g", { class: "above" });
    panel.states.forEach((row, i) =>
      row.forEach((s, k) => {
        const x = left + k * size;
        const y = top + i * size;
        const g = el("g", { class: "cell", tabindex: -1, role: "radio", "data-s": s }, svg);
        const rect = el("rect", { class: "box", x, y, width: size, height: size, rx: 4 }, g);
        if (walls.has(s)) el("rect", { x, y, width: size, height: size, rx: 4, class: "wall over" }, g);
        else if (unreachable.has(s))
          el("rect", { x, y, width: size, height: size, fill: `url(#${hatch})`, class: "over" }, g);
        const cell = {
          s,
          g,
          rect,
          x: x + size / 2,
          y: y + size / 2,
          i,
          k,
          panel,
          type,
          named,
          arrow: el("path", { class: "arrow" }, above),
          text: el("text", { class: "v", x: x + size / 2, y: y + size / 2 + (grid ? 24 : 17) }, above),
          letter: el("text", { class: "letter", x: x + size / 2, y: y + size / 2 + 1 }, above),
        };
        cells.push(cell);
        for (const kind of ["pointerenter", "focus", "click"]) g.addEventListener(kind, () => c.choose(s));
        g.addEventListener("keydown", (event) => {
          const step = ARROWS[event.key];
          const next =
            step && cells.find((other) => other.panel === panel && other.i === i + step[0] && other.k === k + step[1]);
          if (!step) return;
          event.preventDefault();
          if (next) (c.choose(next.s), next.g.focus());
        });
      }),
    );
    if (grid)
      grid.wind.forEach((w, k) =>
        el(
          "text",
          { class: "tick", x: left + (k + 0.5) * size, y: top + rows * size + 18, "text-anchor": "middle" },
          svg,
          (k ? "" : "wind ") + (w < 0 ? "↓" : "↑").repeat(Math.abs(w)),
        ),
      );
    else {
      // Names that would run into one another are left out.
      const every = Math.ceil((0.65 * tick * longestName(panel.columns)) / size);
      panel.rows.forEach((name, i) =>
        el("text", { class: "tick", x: left - 6, y: top + (i + 0.5) * size + 4, "text-anchor": "end" }, svg, name),
      );
      panel.columns.forEach((name, k) =>
        k % every ||
        el(
          "text",
          { class: "tick", x: left + (k + 0.5) * size, y: top + rows * size + 3 + tick, "text-anchor": "middle" },
          svg,
          name,
        ),
      );
      el(
        "text",
        { class: "name", x: left + (columns * size) / 2, y: top + rows * size + 10 + 2 * tick, "text-anchor": "middle" },
        svg,
        [panel.along, panel.down && `rows: ${panel.down}`].filter(Boolean).join("; "),
      );
    }
    if (grid) cells.path = el("path", { class: "way", style: { stroke: colourOf(m) } }, svg);
    svg.append(above);
    if (grid)
      for (const [s, letter] of grid.letters) {
        const cell = cells.find((one) => one.s === s);
        const at = (part) => part - size / 2 + badge + 3;
        el("circle", { class: "badge", cx: at(cell.x), cy: at(cell.y), r: badge }, above);
        el("text", { class: "badge-text", x: at(cell.x), y: at(cell.y) + badge / 2 }, above, letter);
      }
  }
  const ramp = el("p", { class: "ramp soft small" }, box);
  const bar = el("span", { class: "bar" }, ramp);
  const meaning = el("span", {}, ramp);
  const about = el("div", { class: "about", style: { minHeight: `${4 + 1.6 * tables.actions}rem` } }, box);
  const range = rangeOf(c, tables, m);

  function move() {
    const { view, moment, words: said } = viewOf(c, tables, m);
    words.textContent = said;
    for (const cell of cells) {
      const { s } = cell;
      const q = tables.q(view, moment, s);
      const v = worth(q);
      const best = tables.greedy(view, moment, s);
      const over = terminal.has(s);
      const untouched = q.every((x) => x === q[0]) && q.length > 1;
      const sure = tables.agree(view, moment, s);
      const share = over ? NaN : range.share(s, q, tables.visits(view, moment, s));
      cell.rect.style.fill = Number.isNaN(share)
        ? "var(--card)"
        : tint(share < 0 ? "--warm" : range.colour, Math.abs(share));
      const shown = over
        ? ""
        : untouched && state.colour !== "visits"
          ? scene.places
            ? ""
            : "·"
          : state.colour === "visits"
            ? visitsText(tables.visits(view, moment, s))
            : state.colour === "error" && !policy
              ? tight(v - exact(s), cell.type.room)
              : tight(v, cell.type.room);
      cell.text.textContent = shown;
      const arrows = grid && scene.arrows.every(Boolean);
      cell.arrow.setAttribute(
        "d",
        !arrows || over || untouched
          ? ""
          : arrowsPath(
              cell,
              best.map((a) => scene.arrows[a]),
              best.length > 1,
            ),
      );
      cell.letter.textContent =
        arrows || over || q.length < 2 || untouched || !cell.named ? "" : best.map((a) => letters[a]).join("");
      cell.arrow.style.opacity = 0.3 + 0.7 * sure;
      cell.letter.classList.toggle("sure", sure >= SURE);
      const acts = q.length > 1 && !untouched ? `, ${best.map((a) => scene.actions[a]).join(" or ")}` : "";
      cell.g.setAttribute(
        "aria-label",
        walls.has(s) ? "a wall" : over ? "an episode ends here" : `${nameOf(c, s)}: ${fixed(v, tables.decimals)}${acts}`,
      );
    }
    const ways =
      grid && tables.q(view, moment, 0).length > 1 ? greedyWays(c, (s) => tables.greedy(view, moment, s)) : [];
    if (cells.path) {
      const at = (s) => cells.find((cell) => cell.s === s);
      const furthest = 1 + Math.max(0, ...grid.wind.map(Math.abs)); // further lead doors alone
      const isNear = (a, b) => Math.max(Math.abs(a.i - b.i), Math.abs(a.k - b.k)) <= furthest;
      const draw = (cell, i, way) => `${i && isNear(way[i - 1], cell) ? "L" : "M"}${cell.x} ${cell.y}`;
      cells.path.setAttribute("d", ways.flatMap((way) => way.states.map(at).map(draw)).join(""));
      cells.path.setAttribute("stroke-dasharray", ways.every((way) => way.ends) ? "" : "2 9");
    }
    bar.style.background = range.bar;
    const several = view === "mean" || view === "median";
    const lettered = !grid && tables.actions > 1 && cells.some((one) => one.named);
    meaning.textContent =
      range.words +
      (ways.length ? ` ${sentence(waysInWords(ways, grid.stochastic))}.` : "") +
      (lettered ? letters.words : "") +
      (several && grid ? " The fainter an arrow, the fewer seeds agree." : "") +
      (several && lettered ? " Bold: 9 of 10 seeds agree." : "");
    cell();
  }

  function cell() {
    for (const one of cells) {
      one.g.classList.toggle("on", one.s === state.cell);
      one.g.setAttribute("aria-checked", one.s === state.cell);
      one.g.setAttribute("tabindex", one.s === state.cell ? 0 : -1);
    }
    const { view, moment } = viewOf(c, tables, m);
    cellTable(c, about, tables, m, view, moment);
  }

  const says = () => sentence(cells.find((one) => one.s === state.cell)?.g.getAttribute("aria-label") ?? "");
  return { move, cell, says };
}

// The states as a table, for tasks that have no picture.
function listStage(c, box, m, tables) {
  const { scene } = c;
  const words = titleOf(c, box, m);
  const { policy } = c.methods[m].data;
  if (!tables)
    return (
      (words.textContent = "Of this setting there is no table in this page: results.nc has it."),
      { move() {}, cell() {} }
    );
  const several = tables.actions > 1;
  const names = several ? scene.actions : ["V"];
  const states = scene.states
    .map((_, s) => s)
    .filter((s) => !scene.terminal.includes(s) && !scene.unreachable.includes(s));
  const wide = el(
    "div",
    { class: states.length > 20 ? "wide list" : "wide", tabindex: 0, role: "region", "aria-label": "states" },
    box,
  );
  const table = el("table", {}, wide);
  const head = el("tr", {}, el("thead", {}, table));
  const body = el("tbody", {}, table);
  const titles = [
    "state",
    ...(several ? ["greedy"] : []),
    ...names.map((name) => (several ? `${policy ? "π" : "Q"}(${name})` : name)),
    ...(c.exact && !policy ? names.map((name) => (several ? `q*(${name})` : "exact")) : []),
    ...(tables.visits("mean", 0, 0) ? ["visits"] : []),
  ];
  for (const title of titles) el("th", { scope: "col" }, head, title);
  const rows = states.map((s) => {
    const row = el("tr", {}, body);
    el("th", { scope: "row" }, row, `${scene.states[s]}${scene.start.includes(s) ? " (start)" : ""}`);
    return titles.slice(1).map(() => el("td", {}, row));
  });
  asCards(table, "many");
  const order = sorting(table, move);
  if (scene.of > scene.states.length)
    el(
      "p",
      { class: "soft small" },
      box,
      `${scene.states.length} of ${count(scene.of)} states: where episodes start, and those whose values are the furthest from what is exact, or from 0.`,
    );
  function move() {
    const { view, moment, words: said } = viewOf(c, tables, m);
    words.textContent = said;
    states.forEach((s, i) => {
      const q = [...tables.q(view, moment, s)];
      const best = tables.greedy(view, moment, s);
      const visits = tables.visits(view, moment, s);
      const texts = [
        ...(several ? [best.length === q.length ? "any" : best.map((a) => scene.actions[a]).join(" or ")] : []),
        ...q.map((x) => fixed(x, tables.decimals)),
        ...(c.exact && !policy ? [...c.exactOf(s)].map((x) => fixed(x, tables.decimals)) : []),
        ...(visits ? [count(Math.round(total(visits)))] : []),
      ];
      texts.forEach((text, k) => (rows[i][k].textContent = text));
    });
    if (order.by) body.replaceChildren(...order.of([...body.rows]));
  }
  return { move, cell() {} };
}
