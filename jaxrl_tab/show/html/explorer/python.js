// What is shown as the lines of Python that draw it.

const quoted = (x) => JSON.stringify(x);

function opened(method, setting) {
  const lines = [`ds = xr.open_dataset("results.nc", group=${quoted(method.data.group)}, engine="h5netcdf")`];
  if (setting !== undefined && method.data.axes.length) {
    const places = method.places(setting);
    const parts = method.data.axes.map((a, k) => `${quoted(a.name)}: ${quoted(a.values[places[k]])}`);
    lines.push(`ds = ds.sel({${parts.join(", ")}})`);
  }
  return lines.join("\n");
}

function curvesCode(c, lines) {
  const measure = c.data.measures.find((m) => m.key === c.state.measure);
  const median = c.state.view === "median" || measure.middle === "median";
  const level = c.state.band === "all" && !median ? ', confidence=1 - 0.05 / x.sizes["row"]' : "";
  const interval =
    measure.kind === "share"
      ? "stats.proportion_interval(x)"
      : median
        ? "stats.median_interval(x)"
        : `stats.mean_interval(x${level})`;
  const shown = lines.filter((s) => !c.state.off.has(s.name));
  const parts = shown.map((s) =>
    [
      opened(s.m, s.setting),
      `ends = ${quoted(s.m.data.ends)}`,
      measure.code,
      "x = x.where(~ds.diverged)",
      `middle, low, high, n = ${interval}`,
      'few = n < 0.9 * ds.sizes["seed"]  # those that have a number there may be the good ones',
      "middle, low, high = (part.where(~few) for part in (middle, low, high))",
      `time = ${quoted(s.m.data.x)}  # ${c.data.unit}`,
      `ax.plot(time, middle, label=${quoted(s.name)})`,
      ...(c.state.band === "none" ? [] : ["ax.fill_between(time, low, high, alpha=0.2)"]),
    ].join("\n"),
  );
  return [
    "import matplotlib.pyplot as plt\nimport numpy as np\nimport xarray as xr\n\nfrom jaxrl_tab import stats\n",
    "figure, ax = plt.subplots()",
    ...parts,
    `ax.set(xlabel=${quoted(c.data.unit)}, ylabel=${quoted(measure.title)})`,
    "ax.legend()",
    'figure.savefig("curves.png")',
  ].join("\n");
}

function settingsCode(c) {
  const score = c.data.scores.find((s) => s.key === c.state.score);
  const interval = score.middle === "median" ? "stats.median_interval(x)" : "stats.mean_interval(x)";
  const work =
    score.key === "score"
      ? "middle, low, high, n = stats.score_interval(ds)"
      : `${score.code}\nmiddle, low, high, n = ${interval}`;
  const parts = c.methods
    .filter((m) => m.data.axes.some((a) => a.name === c.state.axis))
    .map((m) => {
      const places = m.places(c.settingOf(c.methods.indexOf(m)));
      const rest = m.data.axes
        .map((a, k) => [a, places[k]])
        .filter(([a]) => a.name !== c.state.axis)
        .map(([a, k]) => `${quoted(a.name)}: [${quoted(a.values[k])}]`);
      return [
        opened(m),
        ...(rest.length ? [`ds = ds.sel({${rest.join(", ")}})`] : []),
        work,
        `x = ds[${quoted(c.state.axis)}].values`,
        "middle, low, high = (np.ravel(part) for part in (middle, low, high))",
        `ax.errorbar(x, middle, [middle - low, high - middle], marker="o", label=${quoted(m.data.title)})`,
      ].join("\n");
    });
  return [
    "import matplotlib.pyplot as plt\nimport numpy as np\nimport xarray as xr\n\nfrom jaxrl_tab import stats\n",
    "figure, ax = plt.subplots()",
    ...parts,
    `ax.set(xlabel=${quoted(c.state.axis)}, ylabel=${quoted(score.title)})`,
    "ax.legend()",
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
