// How a score depends on hyperparameters: curves over one, or a heat map over two.

function settingsCard(c) {
  const axes = [...new Map(c.methods.flatMap((m) => m.swept()).map((a) => [a.name, a])).values()];
  if (!axes.length) return null;
  const { section, controls, body } = card(c.root, "Hyperparameters", "settings");
  const { state, data } = c;
  const score = select(
    controls,
    "score",
    data.scores.map((s) => [s.key, s.title]),
    (v) => c.set({ score: v }),
  );
  const axis = select(
    controls,
    "on the axis",
    axes.map((a) => [a.name, a.symbol === a.name ? a.name : `${a.symbol} (${a.name})`]),
    (v) => c.set({ axis: v }),
  );
  const by = select(controls, "a curve for each", [], (v) => c.set({ by: v }));
  const picture = select(
    controls,
    "picture",
    [
      ["curves", "curves"],
      ["heat", "heat map"],
    ],
    (v) => c.set({ picture: v }),
  );
  const kinds = [
    ["auto", "as fits"],
    ["linear", "linear"],
    ["log", "logarithmic"],
  ];
  const scale = select(controls, "vertical axis", kinds, (v) => c.set({ scoreScale: v }));
  const log = check(controls, "logarithmic axis", (on) => c.set({ logAxis: on }));
  const code = el("button", { type: "button" }, controls, "as Python");
  code.addEventListener("click", () =>
    dialog("This picture in Python", drawn.heat ? heatCode(c, drawn.heat) : settingsCode(c, drawn)),
  );
  const told = el("p", { class: "told" }, section); // of the point that the pointer is at, or the focus
  const note = el("p", { class: "note" }, section);
  let focused = null; // the setting whose point has the focus, while all points are drawn anew
  let drawn = null; // as `python.js` asks for it
  if (!axes.some((a) => a.name === state.axis)) state.axis = axes[0].name;

  // The settings along an axis, those of the other axes as chosen: [value, text, number] each.
  function along(m, name, setting) {
    const k = m.data.axes.findIndex((a) => a.name === name);
    if (k >= 0)
      return m.data.axes[k].values.map((v, i) => [v, m.data.axes[k].texts[i], m.number(m.places(setting).with(k, i))]);
    const drawn = m.data.draws.find((a) => a.name === name);
    const draw = m.data.axes.findIndex((a) => a.name === "draw");
    return drawn ? drawn.values.map((v, i) => [v, drawn.texts[i], m.number(m.places(setting).with(draw, i))]) : null;
  }

  // Hyperparameters of the focus method that may be the other axis; those with few values may have a curve for each.
  const others = () =>
    c.methods[state.method].data.axes.filter((a) => a.name !== "draw" && a.name !== state.axis && a.values.length > 1);
  const FEW = 12;

  function draw() {
    const own = c.methods[state.method];
    const more = others();
    const few = more.filter((a) => a.values.length <= FEW);
    const possible = more.length && own.data.axes.some((a) => a.name === state.axis);
    const heat = possible && state.picture === "heat";
    picture.fill(
      possible
        ? [
            ["curves", "curves"],
            ["heat", "heat map"],
          ]
        : [["curves", "curves"]],
    );
    picture.show(heat ? "heat" : "curves");
    const named = (a) => [
      a.name,
      heat ? `${a.symbol} (${own.data.title})` : `value of ${a.symbol} (${own.data.title})`,
    ];
    by.fill(heat ? more.map(named) : [["methods", "method"], ...few.map(named)]);
    by.label.firstChild.textContent = heat ? "up the side" : "a curve for each";
    scale.label.firstChild.textContent = heat ? "colours" : "vertical axis";
    const other = (heat ? more : few).find((a) => a.name === state.by) || (heat ? more[0] : undefined);
    by.show(other ? other.name : "methods");
    (score.show(state.score), axis.show(state.axis), scale.show(state.scoreScale), log.show(state.logAxis));
    told.textContent = "";
    heat ? drawHeat(own, other) : drawCurves(own, other);
  }

  const chosen = () => data.scores.find((s) => s.key === state.score);

  function drawCurves(own, other) {
    const k = data.scores.indexOf(chosen());
    const f = c.methods.indexOf(own);
    const lines = (
      other
        ? other.texts.map((text, i) => ({
            m: own,
            i,
            setting: own.number(own.places(c.settingOf(f)).with(own.data.axes.indexOf(other), i)),
            name: `${other.symbol} = ${text}`,
          }))
        : c.methods.map((m, i) => ({ m, i, setting: c.settingOf(i), name: m.data.title }))
    ).map((line) => ({ ...line, points: along(line.m, state.axis, line.setting) }));
    const points = lines.flatMap((line) => line.points || []);
    const numeric = points.every(([v]) => typeof v === "number");
    const texts = [...new Map(points.map(([v, text]) => [text, v])).entries()];
    if (numeric) texts.sort((a, b) => a[1] - b[1]);
    const at = (v, text) => (numeric ? v : texts.findIndex((t) => t[0] === text));
    const xs = texts.map(([text, v]) => at(v, text));
    const positive = numeric && xs.every((v) => v > 0);
    const logs = positive && state.logAxis;
    log.label.hidden = !positive;
    const longest = Math.max(...texts.map(([text]) => text.length));
    const margin = numeric ? 16 : Math.max(16, 3.5 * longest - 20);
    const x = { ...scaleOf(logs ? "log" : "linear", xs), margin };
    if (logs && xs.length > 1) x.warp = Math.log10;
    const means = lines.flatMap((line) =>
      line.points ? line.points.map((p) => line.m.score(p[2], k)[0]) : [line.m.score(line.setting, k)[0]],
    );
    const optimum = exactly();
    const y = scaleOf(state.scoreScale, [...means, optimum], chosen().kind === "count" ? 0 : undefined);
    const sym = axes.find((a) => a.name === state.axis);
    const name = sym.symbol === sym.name ? sym.name : `${sym.symbol} (${sym.name})`;
    const fr = frame(body, `${chosen().title} against ${name}`, {
      height: 290,
      x,
      y,
      xName: name,
      yName: chosen().title,
      tells: `${lines.map((line) => `${line.name}: ${spanOf(line, k)}.`).join(" ")} The arrow keys go from setting to setting.`,
      xTicks:
        numeric && texts.length > FEW
          ? ticksOf(x, 6).map((v) => [v, minus(String(v))])
          : texts.map(([text, v]) => [at(v, text), text]),
    });
    if (Number.isFinite(optimum))
      el("line", { class: "exact", x1: fr.x0, x2: fr.x1, y1: fr.y(optimum), y2: fr.y(optimum) }, fr.plot);
    const items = [];
    lines.forEach((line) => {
      const colour = colourOf(line.i);
      const dash = dashOf(line.i);
      if (!line.points) {
        const v = fr.y(line.m.score(line.setting, k)[0]);
        if (!Number.isFinite(v)) return;
        el(
          "line",
          { class: "line", x1: fr.x0, x2: fr.x1, y1: v, y2: v, style: { stroke: colour }, "stroke-dasharray": "3 6" },
          fr.plot,
        );
        return;
      }
      const random = line.m.data.draws.some((a) => a.name === state.axis);
      const px = line.points.map(([v, text]) => fr.x(at(v, text)));
      const scores = line.points.map((p) => line.m.score(p[2], k));
      if (numeric && !random)
        el(
          "path",
          {
            class: "line",
            d: linePath(
              px,
              scores.map((s) => fr.y(s[0])),
            ),
            style: { stroke: colour },
            "stroke-dasharray": dash,
          },
          fr.plot,
        );
      scores.forEach((s, i) => {
        if (!Number.isFinite(s[0])) return;
        const [low, high] = [fr.edge(s[1]), fr.edge(s[2])];
        const ends = `M${px[i] - 4} ${low}h8M${px[i] - 4} ${high}h8`;
        if (low - high >= 0)
          el("path", { class: "bar", d: `M${px[i]} ${low}V${high}${ends}`, style: { stroke: colour } }, fr.plot);
        const m = c.methods.indexOf(line.m);
        const here = c.settingOf(m) === line.points[i][2];
        const text = `${line.name}, ${sym.symbol} = ${line.points[i][1]}: ${inNumbers(s)}`;
        const point = chooser(fr.svg, m, line.points[i][2], text, {
          "data-value": s[0],
          "data-low": s[1],
          "data-high": s[2],
        });
        items.push({ e: point, row: line.i, column: i });
        el("circle", { class: "halo", cx: px[i], cy: fr.y(s[0]), r: 11 }, point);
        mark(point, line.i, px[i], fr.y(s[0]), here ? 6 : 4.5, colour);
      });
    });
    const rest = own.data.axes.filter(
      (a) => a.values.length > 1 && a.name !== state.axis && a !== other && a.name !== "draw",
    ).length;
    note.textContent =
      `${chosen().title}: ${chosen().middle} over the seeds, bars are its 95% interval.` +
      (rest ? " What else can be set is as chosen above." : "") +
      " Choose a point to see its setting." +
      (lines.some((line) => !line.points)
        ? " A dotted line: the method does not have this hyperparameter on an axis."
        : "");
    legendOf(lines, optimum);
    drawn = { lines, optimum, scales: { x: logs ? { kind: "log" } : {}, y } };
    navigate(items);
  }

  const legendBox = el("p", { class: "keys" }, section);
  section.insertBefore(legendBox, told);
  function legendOf(lines, optimum) {
    legendBox.replaceChildren();
    for (const line of lines) {
      const key = el("span", { class: "key" }, legendBox);
      swatch(key, colourOf(line.i), line.points ? dashOf(line.i) : "3 6", line.points ? line.i : undefined);
      el("span", {}, key, line.name);
    }
    if (!Number.isFinite(optimum)) return;
    const key = el("span", { class: "key" }, legendBox);
    swatch(key, "var(--soft)", DASHED);
    el("span", {}, key, `exact optimum ${short(optimum)}`);
  }

  // What a score may be compared with: no mean return is above the exact optimum.
  const exactly = () =>
    ["score", "interim", "greedy_value end"].includes(state.score) &&
    data.optimum !== null &&
    chosen().kind === "return"
      ? data.optimum
      : NaN;

  const inNumbers = ([middle, low, high, n]) => `${short(middle)} (${short(low)} to ${short(high)}), ${n} seeds`;

  function spanOf(line, k) {
    const all = (line.points || [[0, "", line.setting]]).map((p) => line.m.score(p[2], k)[0]).filter(Number.isFinite);
    return all.length ? `${short(Math.min(...all))} to ${short(Math.max(...all))}` : "no value";
  }

  // One stop for the tab key: the setting that is shown, or the first one.
  function navigate(items) {
    byArrows(items, items.find(({ e }) => e.classList.contains("here")) || items[0]);
    const again = items.find(({ e }) => e.dataset.setting === focused);
    if (again) again.e.focus();
    focused = null;
  }

  function drawHeat(own, other) {
    log.label.hidden = true;
    const k = data.scores.indexOf(chosen());
    const m = c.methods.indexOf(own);
    const here = own.places(c.settingOf(m));
    const i = own.data.axes.findIndex((a) => a.name === state.axis);
    const j = own.data.axes.indexOf(other);
    const across = own.data.axes[i];
    const number = (a, b) => own.number(here.with(i, a).with(j, b));
    const cells = across.values.flatMap((_, a) => other.values.map((_, b) => own.score(number(a, b), k)[0]));
    const range = scaleOf(state.scoreScale, cells);
    const share = (v) => (range.warp(v) - range.warp(range.low)) / (range.warp(range.high) - range.warp(range.low));
    const ordinal = (n) => ({ kind: "linear", low: -0.5, high: n - 0.5, warp: (v) => v });
    const y = { ...ordinal(other.values.length), text: (v) => other.texts[v] };
    const f = frame(body, `${chosen().title} over ${across.symbol} and ${other.symbol}`, {
      height: Math.max(160, Math.min(460, 70 + 34 * other.values.length)),
      x: ordinal(across.values.length),
      y,
      xName: across.symbol,
      xTicks: across.texts.map((text, a) => [a, text]),
      yTicks: other.values.map((_, b) => b).filter((b) => b % Math.ceil(other.values.length / 20) === 0),
      yName: other.symbol,
      tells: `From ${short(range.low)} to ${short(range.high)}. The arrow keys go from setting to setting.`,
      left: 40 + 7 * Math.max(...other.texts.map((t) => t.length)),
    });
    const w = f.x(1) - f.x(0) || f.x1 - f.x0;
    const h = f.y(0) - f.y(1) || f.y0 - f.y1;
    const better = chosen().kind === "cost";
    const items = [];
    const gap = Math.min(w, h) > 12 ? 1 : 0;
    across.values.forEach((_, a) =>
      other.values.forEach((_, b) => {
        const s = own.score(number(a, b), k);
        const v = s[0];
        const dark = Number.isFinite(v) ? (better ? 1 - share(v) : share(v)) : 0;
        const text = `${across.symbol} = ${across.texts[a]}, ${other.symbol} = ${other.texts[b]}: ${inNumbers(s)}`;
        const g = chooser(f.svg, m, number(a, b), text, { "data-value": v });
        items.push({ e: g, row: -b, column: a });
        el(
          "rect",
          {
            class: "heat",
            x: f.x(a) - w / 2 + gap,
            y: f.y(b) - h / 2 + gap,
            width: w - 2 * gap,
            height: h - 2 * gap,
            style: { fill: Number.isFinite(v) ? tint("--ramp", dark) : "var(--faint)" },
          },
          g,
        );
        if (w > 46 && h > 15)
          el("text", { class: "in", x: f.x(a), y: f.y(b) + 4, "text-anchor": "middle" }, g, short(v));
      }),
    );
    note.textContent = `${own.data.title}: ${chosen().title}, ${chosen().middle} over the seeds: the stronger its colour, the better (${short(range.low)} to ${short(range.high)}${range.kind === "linear" ? "" : ", on a logarithmic scale"}). Choose a cell to see its setting.`;
    legendBox.replaceChildren();
    drawn = { heat: { m: own, setting: c.settingOf(m), across, other, range } };
    navigate(items);
  }

  // A setting of method m that can be chosen: what it is, is read out, and shown beside the pointer.
  function chooser(parent, m, setting, text, data) {
    const here = setting === c.settingOf(m);
    const g = el(
      "g",
      {
        class: here ? "point here" : "point",
        role: "button",
        "aria-pressed": here,
        "aria-label": text,
        "data-setting": `${m}-${setting}`,
        ...data,
      },
      parent,
    );
    if (here && m === state.method) told.textContent = text;
    for (const kind of ["pointerenter", "focus"]) g.addEventListener(kind, () => (told.textContent = text));
    press(g, () => {
      if (document.activeElement === g) focused = g.dataset.setting; // which is drawn anew
      c.pick(m, setting);
    });
    return g;
  }

  return { draw };
}

function press(e, then) {
  e.addEventListener("click", then);
  e.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    then();
  });
}
