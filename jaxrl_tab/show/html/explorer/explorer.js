// A chapter in which one looks around: what is chosen, and what moves with it.

// A method: its settings by number, its curves and scores.
function methodOf(data, curves, scores, sizes) {
  const lengths = data.axes.map((a) => a.values.length);
  const slots = new Map(data.kept.map((setting, i) => [setting, i]));
  const points = data.x.length;
  const rows = sizes.statistics + data.ranks.length;
  const places = (setting) => {
    const all = new Array(lengths.length);
    for (let k = lengths.length - 1, rest = setting; k >= 0; k--)
      ((all[k] = rest % lengths[k]), (rest = Math.floor(rest / lengths[k])));
    return all;
  };
  return {
    data,
    places,
    ranks: data.ranks,
    count: lengths.reduce((a, b) => a * b, 1),
    number: (all) => all.reduce((n, place, k) => n * lengths[k] + place, 0),
    swept: () => [...data.axes.filter((a) => a.name !== "draw" && a.values.length > 1), ...data.draws],
    curve: (setting, measure, statistic) => {
      if (!slots.has(setting)) return null;
      const i = ((slots.get(setting) * sizes.measures + measure) * rows + statistic) * points;
      return curves.subarray(i, i + points);
    },
    // What its features allow: one of the references of the chapter.
    reference: (setting, k) => (slots.has(setting) ? data.references[k][slots.get(setting)] : null),
    // The middle, the bounds of its interval, and the number of seeds.
    score: (setting, k) => scores.subarray((setting * sizes.scores + k) * 4, (setting * sizes.scores + k) * 4 + 4),
    pointAt: (time) =>
      Math.max(
        0,
        data.x.findLastIndex((x) => x <= time),
      ),
    inWords: (setting) =>
      places(setting)
        .flatMap((place, k) => {
          if (data.axes[k].name === "draw") return data.draws.map((a) => `${a.symbol} = ${a.texts[place]}`);
          return data.axes[k].values.length > 1 ? [`${data.axes[k].symbol} = ${data.axes[k].texts[place]}`] : [];
        })
        .join(", "),
    seedName: (setting, rank) =>
      slots.has(setting)
        ? `seed ${data.runs[slots.get(setting)][data.ranks.indexOf(rank)]} (${rank})`
        : `the ${rank} seed`,
  };
}

async function chapter(root, number) {
  const id = `data-${number}`;
  const data = JSON.parse(document.getElementById(id).textContent);
  const sizes = { measures: data.measures.length, scores: data.scores.length, statistics: data.statistics };
  const methods = await Promise.all(
    data.methods.map(async (m, i) =>
      methodOf(m, await floats(`${id}-curves-${i}`), await floats(`${id}-scores-${i}`), sizes),
    ),
  );
  const exact = data.scene?.exact ? await floats(`${id}-exact`) : null;
  const width = exact ? exact.length / data.scene.states.length : 0;
  const defaults = {
    method: data.first,
    beside: -1,
    view: "mean",
    moment: methods[data.first].data.x.length - 1,
    cell: data.scene?.start[0] ?? 0,
    colour: "value",
    measure: data.measures[0].key,
    lines: "methods",
    band: "point",
    scale: "auto",
    logTime: false,
    runs: false,
    score: data.scores[0].key,
    axis: "alpha",
    by: "methods",
    picture: "curves",
    scoreScale: "auto",
    logAxis: true,
  };
  const state = { ...defaults, settings: methods.map((m) => m.data.best), off: new Set() };
  const kept = new Map();
  const c = {
    root,
    data,
    methods,
    state,
    exact,
    scene: data.scene,
    get times() {
      return methods[state.method].data.x;
    },
    exactOf: (s) => exact.subarray(s * width, (s + 1) * width),
    settingOf: (m) => state.settings[m],
    time: () => c.times[Math.min(state.moment, c.times.length - 1)],
    tables: (m) => {
      const setting = state.settings[m];
      const key = `${m}-${setting}`;
      const about = methods[m].data.tables[setting];
      if (!about) return null;
      if (!kept.has(key))
        kept.set(key, tablesOf(`${id}-tables-${key}`, about, data.scene.states.length, methods[m].data.ranks));
      return kept.get(key);
    },
    set: (changes) => (Object.assign(state, changes), draw()),
    pick: (m, setting) => ((state.settings[m] = setting), c.set({ method: m })),
    go: (moment) => ((state.moment = moment), move(), announce()),
    choose: (s) => ((state.cell = s), parts.scene.cell(), remember()),
  };

  const controls = el("form", { class: "controls chosen", "aria-label": "What is shown" }, root);
  controls.addEventListener("submit", (event) => event.preventDefault());
  const choice = {
    method: select(
      controls,
      "method",
      methods.map((m, i) => [i, m.data.title]),
      (v) => c.set({ method: +v }),
    ),
  };
  const setting = el("span", { class: "controls" }, controls);
  const view = select(controls, "runs", [], (v) => c.set({ view: v }));
  const asToml = el("button", { type: "button" }, controls, "setting as TOML");
  asToml.addEventListener("click", () =>
    dialog("This setting as an experiment", toml(methods[state.method], c.settingOf(state.method))),
  );
  // Of states that cannot be counted there is not always something to be seen.
  if (data.absent) el("p", { class: "note" }, root, data.absent);
  const parts = { scene: data.scene ? sceneCard(c) : null, curves: curvesCard(c), settings: settingsCard(c) };
  const player = playerOf(c);
  sortMethods(root.closest("section"));
  const list = listing(c, root.closest("section"));
  const announce = announcer(
    root,
    () => `After ${c.time()} ${data.unit}. ${parts.curves.says()} ${parts.scene?.says() ?? ""}`,
  );

  function drawControls() {
    const m = methods[state.method];
    const places = m.places(c.settingOf(state.method));
    choice.method.show(state.method);
    setting.replaceChildren();
    m.data.axes.forEach((a, k) => {
      const best = m.places(m.data.best)[k];
      const text = (i) =>
        a.name === "draw" ? m.data.draws.map((d) => `${d.symbol} = ${d.texts[i]}`).join(", ") : a.texts[i];
      const box = select(
        setting,
        a.symbol,
        a.values.map((_, i) => [i, text(i) + (i === best ? " ★" : "")]),
        (v) => c.pick(state.method, m.number(places.with(k, +v))),
      );
      box.show(places[k]);
    });
    view.fill([
      ["mean", "mean"],
      ["median", "median"],
      ...m.ranks.map((rank) => [rank, m.seedName(c.settingOf(state.method), rank)]),
    ]);
    view.show(state.view);
    asToml.hidden = !m.data.toml;
  }

  function draw() {
    drawControls();
    parts.curves.draw();
    if (parts.settings) parts.settings.draw();
    list.mark();
    player.draw();
    remember();
    return parts.scene?.draw();
  }

  function move() {
    player.draw();
    parts.scene?.move();
    parts.curves.move();
    remember();
  }

  // The address has what is not as it was at first.
  function remember() {
    const address = new URLSearchParams(
      [...new URLSearchParams(location.hash.slice(1))].filter(
        ([key]) => key.includes(".") && !key.startsWith(`${number}.`),
      ),
    );
    for (const [key, value] of Object.entries(defaults))
      if (state[key] !== value) address.set(`${number}.${key}`, state[key]);
    methods.forEach(
      (m, i) => state.settings[i] !== m.data.best && address.set(`${number}.setting-${i}`, state.settings[i]),
    );
    if (state.off.size) address.set(`${number}.off`, [...state.off].join("\n"));
    const text = address.toString();
    if (text === written) return;
    written = text;
    try {
      history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
    } catch {
      // A frame without an address of its own keeps nothing.
    }
  }

  let written = "";

  function recall() {
    const choices = {
      measure: data.measures.map((x) => x.key),
      score: data.scores.map((x) => x.key),
      view: ["mean", "median", ...methods.flatMap((m) => m.ranks)],
      colour: ["value", "error", "visits"],
      band: ["point", "all", "none"],
      scale: ["auto", "linear", "log"],
      scoreScale: ["auto", "linear", "log"],
      picture: ["curves", "heat"],
    };
    const names = methods.flatMap((m) => m.swept().map((a) => a.name));
    ((choices.axis = names), (choices.lines = ["methods", ...names]), (choices.by = choices.lines));
    const sizes = {
      method: [0, methods.length],
      beside: [-1, methods.length],
      moment: [0, c.times.length],
      cell: [0, data.scene?.states.length ?? 0],
    };
    for (const [key, value] of new URLSearchParams(location.hash.slice(1))) {
      if (!key.startsWith(`${number}.`)) continue;
      const name = key.slice(`${number}.`.length);
      const m = /^setting-(\d+)$/.exec(name);
      if (choices[name]?.includes(value)) state[name] = value;
      else if (typeof defaults[name] === "boolean") state[name] = value === "true";
      else if (sizes[name] && /^-?\d+$/.test(value) && +value >= sizes[name][0] && +value < sizes[name][1])
        state[name] = +value;
      else if (name === "off") state.off = new Set(value.split("\n"));
      else if (m && methods[m[1]] && /^\d+$/.test(value) && +value < methods[m[1]].count) state.settings[m[1]] = +value;
    }
  }

  recall();
  await draw();
  let was = root.clientWidth;
  new ResizeObserver(() => root.clientWidth !== was && ((was = root.clientWidth), draw())).observe(root);
  for (const kind of ["beforeprint", "afterprint"]) addEventListener(kind, () => draw());
  root.dataset.ready = "yes";
}

// The slider over time, with play and pause.
function playerOf(c) {
  const box = el("div", { class: "player", role: "group", "aria-label": "Time" }, c.root);
  const { state } = c;
  const button = el("button", { type: "button" }, box);
  const slider = el("input", { type: "range", min: 0, step: 1, "aria-label": c.data.unit }, box);
  const now = el("output", { "aria-live": "off" }, box); // a sentence is said instead, once it stands still
  let timer = null;
  function play(on) {
    clearInterval(timer);
    timer = on
      ? setInterval(() => (state.moment < c.times.length - 1 ? c.go(state.moment + 1) : play(false)), 160)
      : null;
    button.textContent = on ? "❚❚" : "▶";
    button.setAttribute("aria-label", on ? "Pause" : "Play");
  }
  button.addEventListener("click", () => {
    if (!timer && state.moment >= c.times.length - 1) c.go(0);
    play(!timer);
  });
  slider.addEventListener("input", () => c.go(+slider.value));
  play(false);
  return {
    draw() {
      const last = c.times.length - 1;
      ((slider.max = last), (slider.value = Math.min(state.moment, last)), (box.hidden = last < 1));
      now.textContent = `${count(c.time())} of ${count(c.times[last])} ${c.data.unit}`;
      slider.setAttribute("aria-valuetext", `after ${c.time()} of ${c.times[last]} ${c.data.unit}`);
    },
  };
}

for (const root of document.querySelectorAll(".explorer"))
  chapter(root, root.dataset.chapter).catch((error) => {
    root.dataset.ready = "no";
    el(
      "p",
      { class: "off" },
      root,
      `The pictures cannot be drawn in this browser (${error.message}): the tables have the numbers.`,
    );
    console.error(error);
  });
