// The table of all settings sorts and filters; a row chooses its setting.

const AT_ONCE = 12;

function listing(c, section) {
  const tables = [...section.querySelectorAll("table.settings")];
  if (!tables.length) return { mark() {} };
  const [table, ...more] = tables;
  const body = table.tBodies[0];
  for (const other of more) {
    body.append(...other.tBodies[0].rows);
    other.closest("details").remove();
  }
  const rows = [...body.rows];
  const box = el("div", { class: "controls" });
  table.closest(".wide").before(box);
  const label = el("label", { class: "field" }, box);
  el("span", {}, label, "filter");
  const filter = el("input", { type: "search", placeholder: "such as sarsa 0.5" }, label);
  const all = el("button", { type: "button" }, box);
  const told = el("span", { class: "soft small", role: "status" }, box);
  let open = false;
  let by = -1;
  let down = true;

  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((th, k) => {
    const button = el("button", { type: "button", class: "sort" }, null, th.textContent);
    th.replaceChildren(button);
    button.addEventListener("click", () => {
      down = by === k ? !down : numberIn(rows[0].cells[k].textContent) !== null;
      by = k;
      show();
    });
  });
  const [tomlHead] = c.methods.some((m) => m.data.toml)
    ? [el("th", { scope: "col" }, table.tHead.rows[0], "as TOML")]
    : [];
  for (const row of rows) {
    const [m, setting] = row.dataset.setting.split("-").map(Number);
    const first = row.cells[0];
    const pick = el("button", { type: "button", class: "pick" }, null, first.textContent);
    first.replaceChildren(pick);
    pick.addEventListener("click", () => (c.pick(m, setting), c.root.scrollIntoView({ block: "start" })));
    if (!tomlHead) continue;
    const open = el("button", { type: "button" }, el("td", {}, row), "TOML");
    open.addEventListener("click", () => dialog("This setting as an experiment", toml(c.methods[m], setting)));
  }
  filter.addEventListener("input", show);
  all.addEventListener("click", () => ((open = !open), show()));

  function show() {
    const wanted = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = rows.filter((row) => wanted.every((word) => row.textContent.toLowerCase().includes(word)));
    if (by >= 0) fits.sort((p, q) => compare(p.cells[by].textContent, q.cells[by].textContent) * (down ? -1 : 1));
    heads.forEach((th, k) =>
      k === by ? th.setAttribute("aria-sort", down ? "descending" : "ascending") : th.removeAttribute("aria-sort"),
    );
    body.replaceChildren(...(open ? fits : fits.slice(0, AT_ONCE)));
    all.hidden = fits.length <= AT_ONCE;
    all.textContent = open ? `show the first ${AT_ONCE}` : `show all ${fits.length}`;
    const every = c.methods.reduce((sum, m) => sum + m.count, 0);
    told.textContent = [
      wanted.length && `${count(fits.length)} of ${count(rows.length)} settings`,
      every > rows.length && `the best ${count(rows.length)} of ${count(every)} are here, and all are in summary.csv`,
    ]
      .filter(Boolean)
      .join("; ");
  }

  show();
  return {
    mark() {
      const now = `${c.state.method}-${c.settingOf(c.state.method)}`;
      for (const row of rows) row.classList.toggle("on", row.dataset.setting === now);
    },
  };
}

// The first number in a cell; null where there is none.
function numberIn(text) {
  const plain = text
    .replace(/−/g, "-")
    .replace(/[\u00a0\u202f](?=\d{3})/g, "")
    .replace("∞", "Infinity")
    .match(/^-?(Infinity|[\d.]+(e-?\d+)?)/);
  return plain ? Number(plain[0]) : null;
}

// By numbers, and where there are none by text; what has no number comes last, whatever the order.
function compare(p, q) {
  const [a, b] = [numberIn(p), numberIn(q)];
  if (a === null && b === null) return p < q ? -1 : p > q ? 1 : 0;
  return (a ?? -Infinity) - (b ?? -Infinity) || 0;
}
