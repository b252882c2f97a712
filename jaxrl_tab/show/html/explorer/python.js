// What is shown as the lines of Python that draw it.

const quoted = (x) => JSON.stringify(x);

function opened(method, setting) {
  const lines = [`ds = export.load("results.nc")[${quoted(method.data.group)}]`];
  if (setting !== undefined && method.data.axes.length) {
    const places = method.places(setting);
    const parts = method.data.axes.map((a, k) => `${quoted(a.name)}: ${quoted(a.values[places[k]])}`);
    lines.push(`ds = ds.sel({${parts.join(", ")}})`);
  }
  return lines.join("\n");
}

const START = [
  "import matplotlib.pyplot as plt",
  "import numpy as np",
  "",
  "from jaxrl_tab import export, stats",
  "",
  "figure, ax = plt.subplots()",
];

// The ends of intervals may be infinite, and these nobody can draw.
const FINITE = "middle, low, high = (np.where(np.isfinite(part), part, np.nan) for part in (middle, low, high))";

// How an axis is, as `scaleOf` has it.
function scaleCode(axis, { kind, high }) {
  if (kind === "log") return [`ax.set_${axis}scale("log")`];
  return kind === "minus" ? [`ax.set_${axis}scale("symlog", linthresh=${-high})  # ratios of costs`] : [];
}

// Lines that are exact: title, value and dash.
const exactCode = (lines) =>
  lines.map(
    ({ title, value, dash }) =>
      `ax.axhline(${value}, ls="${dash === DOTTED ? ":" : "--"}", color="grey", label=${quoted(title)})`,
  );

const endCode = (xName, yName, file) => [
  `ax.set(xlabel=${quoted(xName)}, ylabel=${quoted(yName)})`,
  "ax.legend()",
  `figure.savefig(${quoted(file)})`,
];

function curvesCode(c, lines, { scales, exact }) {
  const { state } = c;
  const measure = c.data.measures.find((m) => m.key === state.measure);
  const median = state.view === "median" || measure.middle === "median";
  const level = state.band === "all" && !median ? ', confidence=1 - 0.05 / x.sizes["row"]' : "";
  const interval =
    measure.kind === "share"
      ? "stats.proportion_interval(x)"
      : median
        ? "stats.median_interval(x)"
        : `stats.mean_interval(x${level})`;
  const parts = lines
    .filter((s) => !state.off.has(s.name))
    .flatMap((s) => {
      const seeds = s.m.data.runs[s.m.data.kept.indexOf(s.setting)];
      const one = s.main ? seeds[s.m.ranks.indexOf(state.view)] : undefined;
      const label = `label=${quoted(s.name)}`;
      return [
        opened(s.m, s.setting),
        `ends = ${quoted(s.m.data.ends)}`,
        measure.code,
        "x = x.where(~ds.diverged)",
        `middle, low, high, n = ${interval}`,
        'few = n < 0.9 * ds.sizes["seed"]  # those that have a number there may be the good ones',
        "middle, low, high = (part.where(~few) for part in (middle, low, high))",
        FINITE,
        `time = ${quoted(s.m.data.x)}  # ${c.data.unit}`,
        ...(one === undefined
          ? [`ax.plot(time, middle, ${label})`]
          : ["ax.plot(time, middle, lw=0.8)", `ax.plot(time, x.sel(seed=${one}), lw=2.5, ${label})`]),
        ...(state.band === "none" ? [] : ["ax.fill_between(time, low, high, alpha=0.2)"]),
        ...(state.runs && s.main
          ? [`for seed in ${quoted(seeds)}:`, "    ax.plot(time, x.sel(seed=seed), lw=0.5, alpha=0.5)"]
          : []),
      ];
    });
  return [
    ...START,
    ...parts,
    ...exactCode(exact),
    ...(state.logTime ? scaleCode("x", { kind: "log" }) : []),
    ...scaleCode("y", scales.y),
    ...endCode(c.data.unit, measure.title, "curves.png"),
  ].join("\n");
}

// The lines that work out a score of settings, some of whose hyperparameters are held.
function scoreCode(c, m, setting, free) {
  const score = c.data.scores.find((s) => s.key === c.state.score);
  const places = m.places(setting);
  const held = m.data.axes
    .map((a, k) => [a, places[k]])
    .filter(([a]) => !free.includes(a.name))
    .map(([a, k]) => `${quoted(a.name)}: [${quoted(a.values[k])}]`);
  const mean = ["x = x.where(~ds.diverged)", "middle, low, high, n = stats.mean_interval(x)"];
  const work =
    score.key === "score"
      ? ["middle, low, high, n = stats.score_interval(ds)"]
      : [score.code, ...(score.middle === "median" ? ["middle, low, high, n = stats.median_interval(x)"] : mean)];
  return [opened(m), ...(held.length ? [`ds = ds.sel({${held.join(", ")}})`] : []), ...work];
}

// `lines` as `settings.js` has them: a method, a setting, a name, and the settings along the axis, if any.
function settingsCode(c, { lines, scales, optimum }) {
  const { axis } = c.state;
  const parts = lines.flatMap(({ m, setting, name, points }) => {
    const drawn = m.data.draws.some((a) => a.name === axis);
    const label = `label=${quoted(name)}`;
    return [
      ...scoreCode(c, m, setting, points ? [drawn ? "draw" : axis] : []),
      FINITE,
      ...(points
        ? [
            `x = ds[${quoted(axis)}].values`,
            "middle, low, high = (part.ravel() for part in (middle, low, high))",
            "bars = np.nan_to_num([middle - low, high - middle])",
            `ax.errorbar(x, middle, bars, marker="o", capsize=3, ${drawn ? 'ls="none", ' : ""}${label})`,
          ]
        : [`ax.axhline(middle.item(), ls=":", ${label})`]),
    ];
  });
  const score = c.data.scores.find((s) => s.key === c.state.score);
  return [
    ...START,
    ...parts,
    ...exactCode(Number.isFinite(optimum) ? [{ title: "exact optimum", value: optimum }] : []),
    ...scaleCode("x", scales.x),
    ...scaleCode("y", scales.y),
    ...endCode(axis, score.title, "settings.png"),
  ].join("\n");
}

function heatCode(c, { m, setting, across, other, range }) {
  const score = c.data.scores.find((s) => s.key === c.state.score);
  const ticks = (axis, a) => `ax.set_${axis}ticks(range(${a.values.length}), ${quoted(a.texts)})`;
  const norm = { log: ', norm="log"', minus: `, norm=SymLogNorm(${-range.high})`, linear: "" }[range.kind];
  return [
    ...(range.kind === "minus" ? ["from matplotlib.colors import SymLogNorm"] : []),
    ...START,
    ...scoreCode(c, m, setting, [across.name, other.name]),
    `middle = middle.transpose(${quoted(other.name)}, ${quoted(across.name)}, ...).squeeze()`,
    `image = ax.imshow(middle, origin="lower", aspect="auto", cmap="Blues${score.kind === "cost" ? "_r" : ""}"${norm})`,
    `figure.colorbar(image, label=${quoted(score.title)})`,
    ticks("x", across),
    ticks("y", other),
    `ax.set(xlabel=${quoted(across.name)}, ylabel=${quoted(other.name)})`,
    'figure.savefig("settings.png")',
  ].join("\n");
}

// A setting as an experiment of its own.
function toml(method, setting) {
  const places = method.places(setting);
  const lines = [];
  method.data.axes.forEach((a, k) => {
    if (a.name !== "draw") lines.push(`${a.name} = ${tomlValue(a.values[places[k]])}`);
    else for (const drawn of method.data.draws) lines.push(`${drawn.name} = ${tomlValue(drawn.values[places[k]])}`);
  });
  return `${method.data.toml}${lines.join("\n")}\n`;
}

// TOML tells whole numbers from others by their point.
const tomlValue = (x) => JSON.stringify(x);
