// Elements, and numbers as people read them. Text of the data gets into the page as text alone, never as HTML.

const SVG = "http://www.w3.org/2000/svg";
const IN_SVG = new Set([
  "svg",
  "g",
  "path",
  "line",
  "rect",
  "circle",
  "text",
  "defs",
  "clipPath",
  "pattern",
  "title",
  "desc",
]);

function el(tag, attributes, parent, text) {
  const e = IN_SVG.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (key === "style") Object.assign(e.style, value);
    else if (key.startsWith("aria-")) e.setAttribute(key, String(value));
    else if (value === true) e.setAttribute(key, "");
    else if (value !== false && value !== undefined && value !== null) e.setAttribute(key, value);
  }
  if (text !== undefined) e.textContent = text;
  if (parent) parent.append(e);
  return e;
}

const minus = (text) => text.replace(/-/g, "−").replace("Infinity", "∞");

// With so many decimals; a dash where there is no number, and no minus before zero.
function fixed(x, decimals) {
  if (Number.isNaN(x)) return "–";
  return Number.isFinite(x) ? minus(x.toFixed(decimals).replace(/^-(0(\.0*)?)$/, "$1")) : minus(String(x));
}

// With about four digits.
function short(x) {
  if (!Number.isFinite(x) || x === 0) return fixed(x, 0);
  return fixed(x, Math.min(6, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(x)) + 1e-9))));
}

// Whole numbers in groups of three.
const count = (n) => minus(String(n)).replace(/\B(?=(\d{3})+$)/g, "\u202f");

// A choice with its name: [value, text] each. What changes it goes to `then`.
function select(parent, name, items, then) {
  const label = el("label", { class: "field" }, parent);
  el("span", {}, label, name);
  const box = el("select", {}, label);
  box.addEventListener("change", () => then(box.value));
  const choice = { label, box };
  choice.fill = (now) => {
    box.replaceChildren();
    for (const [value, text] of now) el("option", { value }, box, text);
    label.hidden = now.length < 2;
  };
  choice.show = (value) => (box.value = String(value));
  choice.fill(items);
  return choice;
}

function check(parent, name, then) {
  const label = el("label", { class: "check" }, parent);
  const box = el("input", { type: "checkbox" }, label);
  el("span", {}, label, name);
  box.addEventListener("change", () => then(box.checked));
  return { label, show: (on) => (box.checked = on) };
}

// A wide table whose rows are cards on a phone. Its roles are said, for as cards it is no table to some readers.
function asCards(table, kind) {
  table.classList.add("cards", kind);
  const roles = { table: [table], rowgroup: [table.tHead, ...table.tBodies], row: [...table.rows] };
  for (const [role, elements] of Object.entries(roles)) for (const e of elements) e.setAttribute("role", role);
  const heads = [...table.tHead.rows[0].cells].map((th) => (th.setAttribute("role", "columnheader"), th.textContent));
  for (const body of table.tBodies)
    for (const row of body.rows)
      [...row.cells].forEach((cell, k) => {
        cell.setAttribute("role", cell.scope === "row" ? "rowheader" : "cell");
        if (k) cell.dataset.label = heads[k];
        cell.classList.toggle("nothing", cell.textContent === "–");
      });
}

const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);

// What a screen reader says once things stand still: `says` gives the sentence.
function announcer(parent, says) {
  const box = el("p", { class: "unseen", role: "status" }, parent);
  let timer = null;
  return () => {
    clearTimeout(timer);
    timer = setTimeout(() => (box.textContent = says()), 400);
  };
}

const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

// The arrow keys go from one of some elements to its neighbour, `(row, column)` each; the tab key finds one alone.
function byArrows(items, here) {
  const place = new Map(items.map((item) => [`${item.row},${item.column}`, item]));
  items.forEach((item) => {
    item.e.setAttribute("tabindex", item === here ? 0 : -1);
    item.e.addEventListener("focus", () => items.forEach((x) => x.e.setAttribute("tabindex", x === item ? 0 : -1)));
    item.e.addEventListener("keydown", (event) => {
      const step = ARROWS[event.key];
      if (!step) return;
      event.preventDefault();
      place.get(`${item.row + step[0]},${item.column + step[1]}`)?.e.focus();
    });
  });
}

function card(parent, title, kind) {
  const section = el("section", { class: `card ${kind}`, "aria-label": title }, parent);
  el("h4", {}, section, title);
  const controls = el("div", { class: "controls" }, section);
  return { section, controls, body: el("div", { class: "body" }, section) };
}

// Lines to copy, in a window over the page.
function dialog(title, text) {
  const box = el("dialog", { "aria-label": title }, document.body);
  el("h4", {}, box, title);
  el("pre", { tabindex: 0 }, box, text);
  const row = el("div", { class: "controls" }, box);
  const copy = el("button", { type: "button" }, row, "Copy");
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text);
      copy.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(box.querySelector("pre"));
      copy.textContent = "Selected: press Ctrl+C";
    }
  });
  el("button", { type: "button" }, row, "Close").addEventListener("click", () => box.close());
  box.addEventListener("close", () => box.remove());
  box.showModal();
}
