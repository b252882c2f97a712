// Learning curves: a measure over time, of several settings.

const STATISTICS = {
  mean: 0,
  low: 1,
  high: 2,
  allLow: 3,
  allHigh: 4,
  median: 5,
  medianLow: 6,
  medianHigh: 7,
  n: 8,
  runs: 9,
};

function curvesCard(c) {
  const { section, controls, body } = card(c.root, "Learning curves", "curves");
  const { state, data } = c;
  const measure = select(
    controls,
    "measure",
    data.measures.map((m) => [m.key, m.title]),
    (v) => c.set({ measure: v }),
  );
  const lines = select(controls, "a curve for each", [], (v) => c.set({ lines: v }));
  const bands = [
    ["point", "95% at each point"],
    ["all", "95% for all points at once"],
    ["none", "none"],
  ];
  const band = select(controls, "bands", bands, (v) => c.set({ band: v }));
  const kinds = [
    ["auto", "as fits"],
    ["linear", "linear"],
    ["log", "logarithmic"],
  ];
  const scale = select(controls, "vertical axis", kinds, (v) => c.set({ scale: v }));
  const logTime = check(controls, "logarithmic time", (on) => c.set({ logTime: on }));
  const runs = check(controls, "single runs", (on) => c.set({ runs: on }));
  const code = el("button", { type: "button" }, controls, "as Python");
  code.addEventListener("click", () => dialog("These curves in Python", curvesCode(c, series(), drawn)));
  const legend = el("table", { class: "legend", role: "table" }, section);
  el("caption", {}, legend);
  const note = el("p", { class: "note" }, section);
  let cursor = null;
  let drawn = null; // the axes, and what is exact

  const chosen = () => data.measures.find((m) => m.key === state.measure);

  // What is drawn: a method, a setting, a name and how it looks.
  function series() {
    const focus = state.method;
    const own = c.methods[focus];
    const axis = own.data.axes.findIndex((a) => a.name === state.lines);
    if (axis < 0)
      return c.methods.map((m, i) => ({
        m,
        setting: c.settingOf(i),
        name: m.data.title,
        colour: colourOf(i),
        dash: dashOf(i),
        i,
        main: i === focus,
      }));
    const here = own.places(c.settingOf(focus));
    const values = own.data.axes[axis];
    return values.texts.map((text, k) => {
      const place = here.with(axis, k);
      const setting = own.number(place);
      return {
        m: own,
        setting,
        name: `${values.symbol} = ${text}`,
        colour: colourOf(k),
        dash: dashOf(Math.floor(k / COLOURS) + (k % COLOURS)),
        i: k,
        main: setting === c.settingOf(focus),
      };
    });
  }

  // What is exact, as lines: title, value, colour and dash. Of values that are functions of features it is what these
  // allow, one line for all curves where it is the same for all, else one for each in its colour.
  function exactly(shown) {
    const optimum = { title: "exact optimum", value: data.optimum, colour: "var(--soft)", dash: DASHED };
    if (state.measure === "return") return data.optimum === null ? [] : [optimum];
    return data.references.flatMap(({ measure, title }, k) => {
      if (measure !== state.measure) return [];
      const dash = k ? DOTTED : DASHED;
      const each = shown
        .map((s) => ({ s, value: s.m.reference(s.setting, k) }))
        .filter(({ value }) => typeof value === "number");
      return new Set(each.map(({ value }) => value.toPrecision(6))).size === 1
        ? [{ title, value: each[0].value, colour: "var(--soft)", dash }]
        : each.map(({ s, value }) => ({ title: `${title}, ${s.name}`, value, colour: s.colour, dash }));
    });
  }

  // Which statistic is shown, and between which its band lies.
  function statistics(line) {
    const middle = state.view === "median" || chosen().middle === "median" ? "median" : "mean";
    const rank = line.main && line.m.ranks.indexOf(state.view);
    const at = rank >= 0 && rank !== false ? STATISTICS.runs + rank : STATISTICS[middle];
    if (state.band === "none") return { at, middle };
    if (middle === "median") return { at, middle, low: STATISTICS.medianLow, high: STATISTICS.medianHigh };
    const all = state.band === "all";
    return {
      at,
      middle,
      low: all ? STATISTICS.allLow : STATISTICS.low,
      high: all ? STATISTICS.allHigh : STATISTICS.high,
    };
  }

  function draw() {
    const all = series();
    const kept = all.filter((s) => s.m.curve(s.setting, 0, 0));
    const m = data.measures.indexOf(chosen());
    const shown = kept.filter((s) => !state.off.has(s.name));
    const unit = data.unit === "steps" ? "time steps" : "episodes";
    (measure.show(state.measure),
      band.show(state.band),
      scale.show(state.scale),
      logTime.show(state.logTime),
      runs.show(state.runs));
    const own = c.methods[state.method].data;
    lines.fill([
      ["methods", "method"],
      ...own.axes
        .filter((a) => a.values.length > 1 && a.values.length <= 60 && a.name !== "draw")
        .map((a) => [a.name, `value of ${a.symbol} (${own.title})`]),
    ]);
    lines.show(state.lines);
    if (lines.box.selectedIndex < 0) lines.show("methods");
    const statisticsOf = (s) => [
      statistics(s).at,
      ...(statistics(s).at >= STATISTICS.runs ? [STATISTICS[statistics(s).middle]] : []),
      ...(state.runs && s.main ? s.m.ranks.map((_, k) => STATISTICS.runs + k) : []),
    ];
    const values = shown.flatMap((s) => statisticsOf(s).flatMap((k) => [...s.m.curve(s.setting, m, k)]));
    const exact = exactly(shown);
    const y = scaleOf(
      chosen().kind === "share" ? "linear" : state.scale,
      chosen().kind === "share" ? [0, 1] : [...values, ...exact.map((line) => line.value)],
      chosen().kind === "count" ? 0 : undefined,
    );
    const times = shown.length ? shown[0].m.data.x : c.times;
    const last = times[times.length - 1];
    const x = state.logTime
      ? { kind: "log", low: times[0], high: last, warp: Math.log10 }
      : { kind: "linear", low: 0, high: last, warp: (v) => v };
    const xTicks = ticksOf(x, Math.max(2, body.clientWidth / 120)).map((v) => [v, count(v)]);
    const f = frame(body, `${chosen().title} over time`, {
      height: 310,
      x,
      y,
      xName: unit,
      xTicks,
      yName: chosen().title,
      tells: shown
        .map((s) => `${s.name}: ${short(s.m.curve(s.setting, m, statistics(s).at).at(-1))} in the end.`)
        .join(" "),
    });
    for (const { value, colour, dash } of exact) {
      const style = { stroke: colour, strokeDasharray: dash };
      el("line", { class: "exact", x1: f.x0, x2: f.x1, y1: f.y(value), y2: f.y(value), style }, f.plot);
    }
    drawn = { scales: { y }, exact };
    const marks = [];
    for (const s of shown) {
      const at = statistics(s);
      const of = (k) => s.m.curve(s.setting, m, k);
      const xs = s.m.data.x.map(f.x);
      const path = (k, kind) =>
        el(
          "path",
          {
            class: kind,
            d: linePath(xs, Array.from(of(k), f.y)),
            style: { stroke: s.colour },
            "stroke-dasharray": s.dash,
          },
          f.plot,
        );
      if (at.low !== undefined) {
        const d = bandPath(xs, Array.from(of(at.low), f.edge), Array.from(of(at.high), f.edge));
        el("path", { class: "band", d, style: { fill: s.colour } }, f.plot);
      }
      if (state.runs && s.main) s.m.ranks.forEach((_, k) => path(STATISTICS.runs + k, "line single"));
      if (at.at >= STATISTICS.runs) path(STATISTICS[at.middle], "line single");
      path(at.at, s.main ? "line main" : "line");
      marks.push({ s, at, of, xs, dot: mark(f.plot, s.i, 0, 0, s.main ? 5 : 4, s.colour) });
    }
    cursor = { f, marks, line: el("line", { class: "cursor", y1: f.y1, y2: f.y0 }, f.svg) };
    scrub(el("rect", { class: "hit", x: f.x0, y: f.y1, width: f.x1 - f.x0, height: f.y0 - f.y1 }, f.svg), f, times);
    drawLegend(all);
    for (const { title, value, colour, dash } of exact) {
      const row = el("tr", { role: "row" }, legend);
      const key = el("span", { class: "key" }, el("th", { scope: "row", role: "rowheader" }, row));
      swatch(key, colour, dash);
      el("span", {}, key, title);
      el("td", { class: "number", role: "cell", "data-exact": title }, row, short(value));
      el("td", { role: "cell" }, row);
    }
    const some = c.methods.some((one) => one.data.kept.length < one.count);
    const middle = shown.length && statistics(shown[0]).middle;
    const one = shown.find((s) => statistics(s).at >= STATISTICS.runs);
    const single = one && one.m.seedName(one.setting, state.view);
    note.textContent = [
      shown.length && `Lines: ${middle} over the seeds${single ? `; thick: ${single}` : ""}.`,
      state.band !== "none" &&
        `Bands: 95% intervals of the ${middle}${state.band === "all" && middle === "mean" ? ", that hold at all points at once (Bonferroni)" : ", each point for itself"}.`,
      chosen().partial &&
        values.some(Number.isNaN) &&
        "There is no line where fewer than 9 of 10 seeds ended an episode: those that did are the better ones.",
      some &&
        `This page has the curves of ${c.methods.map((one) => `${count(one.data.kept.length)} of ${count(one.count)} settings of ${one.data.title}`).join(", ")}: the best, and those that differ from it in one value. All are in results.nc.`,
    ]
      .filter(Boolean)
      .join(" ");
    move();
  }

  function drawLegend(all) {
    legend.querySelectorAll("tr").forEach((row) => row.remove());
    for (const s of all) {
      const kept = s.m.curve(s.setting, 0, 0) !== null;
      const on = kept && !state.off.has(s.name);
      const row = el("tr", { class: on ? (s.main ? "main" : "") : "off", role: "row" }, legend);
      const button = el(
        "button",
        { type: "button", class: "toggle", "aria-pressed": on, disabled: !kept },
        el("th", { scope: "row", role: "rowheader" }, row),
      );
      swatch(button, s.colour, s.dash, s.i);
      el(
        "span",
        {},
        button,
        (s.m.data.axes.length && state.lines === "methods"
          ? `${s.name} (${s.m.inWords(s.setting)})`
          : s.name
        ).replaceAll(" = ", "\u00a0=\u00a0"),
      );
      button.addEventListener("click", () => {
        state.off.has(s.name) ? state.off.delete(s.name) : state.off.add(s.name);
        c.set({});
      });
      el("td", { "data-curve": s.name, class: "number", role: "cell" }, row, kept ? "" : "no curve here");
      for (let k = 0; k < 2; k++) el("td", { class: "soft", role: "cell" }, row);
    }
  }

  // The cursor and the numbers at it.
  function move() {
    if (!cursor) return;
    const time = c.time();
    const { f } = cursor;
    (cursor.line.setAttribute("x1", f.x(time)), cursor.line.setAttribute("x2", f.x(time)));
    legend.caption.textContent = `after ${count(time)} ${data.unit}`;
    for (const { s, at, of, xs, dot } of cursor.marks) {
      const k = s.m.pointAt(time);
      const v = of(at.at)[k];
      dot.setAttribute("transform", `translate(${xs[k]} ${Number.isFinite(v) ? f.y(v) : 0})`);
      dot.style.display = Number.isFinite(v) ? "" : "none";
      const cell = [...legend.querySelectorAll("td[data-curve]")].find((td) => td.dataset.curve === s.name);
      ((cell.textContent = short(v)), (cell.dataset.value = v));
      const ofSeeds = at.at < STATISTICS.runs;
      const bounds = ofSeeds && at.low !== undefined && Number.isFinite(v);
      const interval = cell.nextSibling;
      interval.textContent = bounds ? `${short(of(at.low)[k])} to ${short(of(at.high)[k])}` : "";
      interval.nextSibling.textContent = ofSeeds ? `${of(STATISTICS.n)[k]} seeds` : "";
    }
  }

  const says = () =>
    `${sentence(chosen().title)}: ${cursor.marks.map(({ s, at, of }) => `${s.name} ${short(of(at.at)[s.m.pointAt(c.time())])}`).join(", ")}.`;

  function scrub(hit, f, times) {
    const moment = (event) => {
      const box = f.svg.getBoundingClientRect();
      const at = ((event.clientX - box.left) * f.W) / box.width;
      c.go(times.reduce((best, t, i) => (Math.abs(f.x(t) - at) < Math.abs(f.x(times[best]) - at) ? i : best), 0));
    };
    hit.addEventListener("pointerdown", (event) => (hit.setPointerCapture(event.pointerId), moment(event)));
    hit.addEventListener("pointermove", (event) => hit.hasPointerCapture(event.pointerId) && moment(event));
  }

  return { draw, move, says };
}
