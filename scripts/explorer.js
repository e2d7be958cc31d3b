"use strict";
// All tables of results: chosen, filtered, sorted, and one column drawn with its intervals.

const EVERY = "every table";
const COMMON = ["clips", "iou", "add", "add_sym", "right_in_camera", "sca", "seconds"];
const COLOURS = ["#2a6f97", "#c8553d", "#588157", "#7d4f9e", "#b08900", "#3d405b", "#d1495b", "#00798c"];
const state = { table: EVERY, by: "", down: true };

const key = (label) => label.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "");
const middle = (cell) => Array.isArray(cell) ? cell[0] : cell;
const isNumber = (cell) => typeof middle(cell) === "number";

/** The columns and rows of what is chosen: of one table, its differences, or the common columns of all. */
function chosen() {
  if (state.table !== EVERY) {
    const table = data[state.table], differs = byId("differences").checked && table.differences;
    const rows = (differs ? table.differences : table.rows).map((row) => ({ ...row, label: differs ? `${row.label} − ${row.against}` : row.label }));
    return { columns: table.columns.filter((one) => rows.some((row) => one.key in row)), rows };
  }
  const tables = Object.entries(data).filter(([name, table]) => !name.endsWith("-categories") && table.columns.some((one) => one.key === "add_sym"));
  const columns = COMMON.map((name) => tables.flatMap(([, table]) => table.columns).find((one) => one.key === name)).filter(Boolean);
  return { columns, rows: tables.flatMap(([name, table]) => table.rows.map((row) => ({ ...row, label: `${row.label} · ${name}`, table: name }))) };
}

/** The rows that have all words that are looked for, in the order that is chosen; those without a value last. */
function listed(rows) {
  const words = byId("words").value.toLowerCase().split(/\s+/).filter(Boolean);
  const left = rows.filter((row) => words.every((word) => row.label.toLowerCase().includes(word)));
  if (!state.by) return left;
  const sign = state.down ? -1 : 1, value = (row) => middle(row[state.by]);
  return left.sort((a, b) => {
    const [x, y] = [value(a), value(b)], missing = (one) => one === undefined || one === null;
    if (missing(x) || missing(y)) return missing(x) - missing(y);
    return sign * (isNumber(x) && isNumber(y) ? x - y : String(x).localeCompare(String(y)));
  });
}

/** A cell as text, its interval in small. */
function shown(cell, { digits = 0 }) {
  if (cell === undefined || cell === null) return ["–"];
  if (typeof cell === "object" && !Array.isArray(cell)) return [Object.entries(cell).map(([name, count]) => `${name} ${count}`).join(", ")];
  if (!isNumber(cell)) return [cell];
  const text = middle(cell).toFixed(digits).replace("-", "−");
  if (!Array.isArray(cell) || cell[1] === null) return [text];
  return [text, " ", element("small", {}, `[${cell[1]}, ${cell[2]}]`)];
}

function heading(column) {
  const arrow = column.key === state.by ? (state.down ? " ▾" : " ▴") : "";
  return element("th", {}, element("button", {
    type: "button",
    onclick: () => {
      state.down = column.key === state.by ? !state.down : true;
      state.by = column.key;
      show();
    },
  }, `${column.label}${column.unit && column.unit !== column.label ? `, ${column.unit}` : ""}${arrow}`));
}

function grid(columns, rows) {
  const lines = rows.map((row) => element("tr", {}, element("td", {}, row.label),
    ...columns.map((one) => element("td", { class: isNumber(row[one.key]) ? "number" : "" }, ...shown(row[one.key], one)))));
  return element("table", {}, element("thead", {}, element("tr", {}, element("th"), ...columns.map(heading))), element("tbody", {}, ...lines));
}

/** A dot with its interval for each row; rows of a method have a colour. */
function plot(column, rows) {
  const known = rows.filter((row) => isNumber(row[column.key])).slice(0, 80);
  if (known.length < 2) return "";
  const ends = known.flatMap((row) => [row[column.key]].flat().slice(0, 3)).filter((value) => value !== null);
  const low = Math.min(...ends), high = Math.max(...ends), span = high - low || 1;
  const [W, left, line, top] = [860, 380, 15, 22], H = top + line * known.length + 4;
  const x = (value) => left + ((W - left - 16) * (value - low)) / span;
  const method = (row) => row.label.split(/, | · | − /)[0];
  const methods = [...new Set(known.map(method))].sort();
  const drawn = element("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": column.label });
  for (const value of Plot.ticks(low, high)) {
    drawn.append(element("line", { x1: x(value), x2: x(value), y1: top - 6, y2: H, class: "grid" }),
      element("text", { x: x(value), y: 11, class: "tick" }, String(value)));
  }
  known.forEach((row, n) => {
    const y = top + line * (n + 0.5), cell = [row[column.key]].flat(), colour = COLOURS[methods.indexOf(method(row)) % COLOURS.length];
    drawn.append(element("text", { x: left - 10, y: y + 4, class: "name" }, row.label.length > 60 ? `${row.label.slice(0, 59)}…` : row.label));
    if (cell.length > 2 && cell[1] !== null) drawn.append(element("line", { x1: x(cell[1]), x2: x(cell[2]), y1: y, y2: y, stroke: colour, "stroke-width": 2 }));
    drawn.append(element("rect", { x: x(cell[0]) - 3.5, y: y - 3.5, width: 7, height: 7, rx: 3.5, fill: colour }));
  });
  return drawn;
}

function about() {
  if (state.table === EVERY) return [element("p", {}, "Common columns of all tables with ADD (sym.); choose one for the rest.")];
  const { title, made, notes = [] } = data[state.table];
  const how = [made.commit && `commit ${made.commit}`, made.date, made.machine, made.versions].filter(Boolean).join("; ");
  return [element("h2", {}, title), element("p", {}, how), element("p", {}, element("code", {}, made.command || "")),
    element("details", {}, element("summary", {}, "settings"), element("ul", {}, ...notes.map((note) => element("li", {}, note))))];
}

function show() {
  const { columns, rows } = chosen(), left = listed(rows), numbers = columns.filter((one) => rows.some((row) => isNumber(row[one.key])));
  const drawn = byId("drawn"), before = drawn.value;
  drawn.replaceChildren(...numbers.map((one) => element("option", { value: one.key }, `${one.label}${one.unit ? `, ${one.unit}` : ""}`)));
  drawn.value = numbers.some((one) => one.key === before) ? before : (numbers.find((one) => one.key === "add_sym") || numbers[0] || {}).key;
  byId("differences").parentElement.hidden = state.table === EVERY || !data[state.table].differences;
  byId("about").replaceChildren(...about(), element("p", {}, `${left.length} of ${rows.length} rows`));
  const column = numbers.find((one) => one.key === drawn.value);
  byId("plot").replaceChildren(column ? plot(column, left) : "");
  byId("rows").replaceChildren(grid(columns, left));
}

/** Choose a table and, behind a "/", words: explore.html#dexycb-methods/soft-hinge. */
function follow() {
  const [name, words = ""] = decodeURIComponent(location.hash.slice(1)).split("/");
  state.table = name in data ? name : EVERY;
  state.by = "";
  byId("table").value = state.table;
  byId("words").value = words;
  show();
}

function start() {
  byId("table").append(...[EVERY, ...Object.keys(data)].map((name) => element("option", { value: name }, name in data ? `${name}: ${data[name].title}` : name)));
  byId("table").addEventListener("input", () => { location.hash = byId("table").value in data ? byId("table").value : ""; });
  for (const id of ["words", "drawn", "differences"]) byId(id).addEventListener("input", show);
  window.addEventListener("hashchange", follow);
  follow();
  document.body.dataset.ready = "explorer";
}

start();
