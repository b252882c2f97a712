// Tables sort; that of all settings filters as well, and a row of it chooses its setting.

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
  const order = sorting(table, show);
  const [tomlHead] = c.methods.some((m) => m.data.toml)
    ? [el("th", { scope: "col", class: "tool" }, table.tHead.rows[0], "as TOML")]
    : [];
  for (const row of rows) {
    const [m, setting] = row.dataset.setting.split("-").map(Number);
    const first = row.cells[0];
    const pick = el("button", { type: "button", class: "pick" }, null, first.textContent);
    first.replaceChildren(pick);
    pick.addEventListener("click", () => (c.pick(m, setting), c.root.scrollIntoView({ block: "start" })));
    if (!tomlHead) continue;
    const name = `TOML of ${[c.methods[m].data.title, c.methods[m].inWords(setting)].filter(Boolean).join(", ")}`;
    const open = el("button", { type: "button", "aria-label": name }, el("td", { class: "tool" }, row), "TOML");
    open.addEventListener("click", () => dialog("This setting as an experiment", toml(c.methods[m], setting)));
  }
  asCards(table, "many");
  filter.addEventListener("input", show);
  all.addEventListener("click", () => ((open = !open), show()));

  function show() {
    const wanted = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = rows.filter((row) => wanted.every((word) => row.textContent.toLowerCase().includes(word)));
    const sorted = order.of(fits);
    body.replaceChildren(...(open ? sorted : sorted.slice(0, AT_ONCE)));
    all.hidden = fits.length <= AT_ONCE;
    all.textContent = open ? `show the first ${AT_ONCE}` : `show all ${fits.length}`;
    const every = c.methods.reduce((sum, m) => sum + m.count, 0);
    told.textContent = [
      order.by,
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

// Makes the heads of a table buttons that sort it: `then` shows it again, with its rows in the order `of` gives.
function sorting(table, then) {
  const heads = [...table.tHead.rows[0].cells];
  const names = heads.map((th) => th.textContent);
  const order = { by: "", of: (rows) => rows };
  let column = -1;
  let down = true;
  heads.forEach((th, k) => {
    const button = el("button", { type: "button", class: "sort" }, null, names[k]);
    th.replaceChildren(button);
    button.addEventListener("click", () => {
      const numbers = [...table.tBodies[0].rows].some((row) => numberIn(row.cells[k].textContent) !== null);
      ((down = column === k ? !down : numbers), (column = k));
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      const way = down ? "descending" : "ascending";
      th.setAttribute("aria-sort", way);
      order.by = `sorted by ${names[k]}, ${way}`;
      const text = (row) => row.cells[k].textContent;
      order.of = (rows) => [...rows].sort((p, q) => compare(text(p), text(q), down));
      then();
    });
  });
  return order;
}

// The table of methods sorts, where there are several.
function sortMethods(section) {
  const table = section.querySelector("table.chosen-table");
  const [body] = table.tBodies;
  if (body.rows.length < 2) return;
  const told = el("p", { class: "unseen", role: "status" });
  table.closest(".wide").after(told);
  const order = sorting(table, () => {
    body.replaceChildren(...order.of([...body.rows]));
    told.textContent = order.by;
  });
}

// The first number in a cell; null where there is none.
function numberIn(text) {
  const plain = text
    .replace(/−/g, "-")
    .replace(/[\u00a0\u202f](?=\d{3})/g, "")
    .replace("∞", "Infinity")
    .match(/^(?:< )?(-?(?:Infinity|\d[\d.]*(?:e-?\d+)?))/);
  return plain ? Number(plain[1]) : null;
}

// By numbers, and then by text: what has no number comes last, whatever the order.
function compare(p, q, down) {
  const [a, b] = [numberIn(p), numberIn(q)];
  if (a === null || b === null) {
    if ((a === null) !== (b === null)) return a === null ? 1 : -1;
    return (p < q ? -1 : p > q ? 1 : 0) * (down ? -1 : 1);
  }
  return (a < b ? -1 : a > b ? 1 : 0) * (down ? -1 : 1);
}
