"use strict";
// The page of many results.

const FLAGS = {
  any: "all", failed: "failed", left: "not done", misfit: "poor fit", serious: "serious finding", note: "note", ambiguous: "ambiguous", dropped: "dropped", guess: "guesses",
  unread: "could not be read", none: "none of these",
};
const BAD_FLAGS = new Set(["serious", "misfit"]);
const column = (name) => data.columns.find((one) => one.name === name);

/** A value as text; below `least`, or as near to 1, which of the two it is. */
function number(value, { unit, decimals, least }) {
  if (least && value !== null && value !== undefined && (value < least || value > 1 - least)) {
    return value < least ? `< ${100 * least}` : `> ${100 * (1 - least)}`;
  }
  return value === null || value === undefined ? "–" : (unit === "%" ? 100 * value : value).toFixed(decimals);
}

function unitOf({ unit }) {
  return unit === "deg" ? "°" : unit;
}

const hasFailed = (row) => row.flags.includes("failed");
const flagsOf = (row) => row.problem && !hasFailed(row) && !row.flags.includes("left") ? [...row.flags, "unread"] : row.flags;

const textOf = new Map(data.rows.map((row) => [row, [row.clip, row.method, row.folder, row.status, row.problem, ...row.warnings].join(" ").toLowerCase()]));

/** Whether a row has a flag, or any, or none. */
function flagged(row, flag) {
  const flags = flagsOf(row);
  return flag === "any" || (flag === "none" ? flags.length === 0 : flags.includes(flag));
}

/** The rows that the fields leave, but for flags and histograms. */
function found() {
  const words = byId("words").value.toLowerCase().split(/\s+/), set = byId("sets").value;
  return data.rows.filter((row) => (set === "*" || row.set === set) && words.every((word) => textOf.get(row).includes(word)));
}

/** Rows in the order that is chosen: failed ones first, or last; those without a value last. */
function sorted(rows) {
  const by = column(byId("by").value), sign = (by.more ? 1 : -1) * (byId("order").value === "worst" ? 1 : -1);
  const value = (row) => row.values[by.name] ?? null, worst = byId("order").value === "worst" ? 1 : -1;
  return rows.sort((a, b) => {
    if (hasFailed(a) !== hasFailed(b)) return worst * (hasFailed(b) - hasFailed(a));
    if (value(a) === null || value(b) === null) return (value(a) === null) - (value(b) === null);
    return sign * (value(a) - value(b)) || (a.folder < b.folder ? -1 : 1);
  });
}

function badges(row) {
  return flagsOf(row).map((flag) => element("span", { class: `badge${flag === "failed" ? " failed" : BAD_FLAGS.has(flag) ? " bad" : ""}` }, FLAGS[flag]));
}

/** A link to the result's page, where it has one. */
function linked(row, ...children) {
  return row.link ? element("a", { href: row.link }, ...children) : element("span", {}, ...children);
}

const picture = (row) => row.thumbnail ? element("img", { src: `data:image/jpeg;base64,${row.thumbnail}`, alt: "", decoding: "async" }) : "";
const title = (row) => row.clip || row.folder;
const about = (row) => [row.set || row.method, row.problem].filter(Boolean).join(": ");

const BLOCK = 24, GUESS = 90;  // rows that are drawn at once, a multiple of the gallery's columns, and their height before one was [px]
let watching = null;

function tall(tag, height) {
  const made = element(tag);
  made.style.height = `${height}px`;
  return made;
}

/** Elements for blocks of rows, each drawn while it is near the window, and else as tall as it was, or as others are. */
function inBlocks(rows, draw, blank) {
  watching?.disconnect();
  const blocks = new Map();
  const swap = (old, made, block) => {
    blocks.delete(old);
    watching.unobserve(old);
    old.replaceWith(made);
    blocks.set(made, block);
    watching.observe(made);
  };
  watching = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting, boundingClientRect: { height } } of seen) {
      const block = blocks.get(target);
      if (!block || isIntersecting === block.drawn) continue;
      if (block.drawn) block.height = height;
      block.drawn = isIntersecting;
      swap(target, isIntersecting ? draw(block.rows) : blank(block.height), block);
    }
  }, { rootMargin: "1200px 0px" });
  const made = [];
  for (let first = 0; first < rows.length; first += BLOCK) {
    const some = rows.slice(first, first + BLOCK), drawn = first === 0;
    made.push(drawn ? draw(some) : blank(GUESS * some.length));
    blocks.set(made.at(-1), { rows: some, drawn, height: GUESS * some.length });
  }
  for (const one of made) watching.observe(one);
  return made;
}

function table(rows) {
  const by = byId("by").value;
  const heads = data.columns.map((one) => element("th", {
    class: one.name === by ? "by" : "", "aria-sort": one.name === by ? "other" : null,
  }, element("button", {
    type: "button",
    onclick: () => {
      const same = byId("by").value === one.name;
      byId("order").value = same && byId("order").value === "worst" ? "best" : "worst";
      byId("by").value = one.name;
      show();
    },
  }, one.name, element("small", {}, ` ${unitOf(one)}`))));
  const line = (row) => element("tr", {},
    element("td", { class: "thumbnail" }, linked(row, picture(row))),
    element("td", { class: "name" }, linked(row, title(row)), element("small", {}, about(row)), element("div", {}, ...badges(row)),
      ...row.warnings.map((words) => element("small", { class: "warning" }, words))),
    ...data.columns.map((one) => element("td", { class: one.name === by ? "value by" : "value" }, number(row.values[one.name], one))));
  const blocks = inBlocks(rows, (some) => element("tbody", {}, ...some.map(line)), (height) => element("tbody", {}, element("tr", { "aria-hidden": "true" }, tall("td", height))));
  const head = element("tr", {}, element("th", { class: "thumbnail" }, "picture"), element("th", { class: "name" }, "result"), ...heads);
  return element("table", { class: "rows", "aria-rowcount": rows.length + 1 }, element("thead", {}, head), ...blocks);
}

function gallery(rows) {
  const by = column(byId("by").value);
  const figure = (row) => element("figure", {}, linked(row, picture(row)),
    element("figcaption", {}, linked(row, title(row)), element("b", {}, `${number(row.values[by.name], by)} ${unitOf(by)}`),
      element("small", {}, about(row)), element("div", {}, ...badges(row))));
  return element("div", {}, ...inBlocks(rows, (some) => element("div", { class: "gallery" }, ...some.map(figure)), (height) => tall("div", height)));
}

/** Means of shares and medians of the rest, of each set of the rows that are shown. */
function summary(rows) {
  const sets = new Map();
  for (const row of rows.filter((one) => one.clip)) {
    if (!sets.has(row.set)) sets.set(row.set, []);
    sets.get(row.set).push(row);
  }
  if (sets.size === 0) return "";
  const middle = (values) => {
    const sorted = [...values].sort((a, b) => a - b), half = Math.floor(sorted.length / 2);
    return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
  };
  const lines = [...sets].map(([set, members]) => element("tr", {}, element("th", {}, set || members[0].method), element("td", {}, members.length),
    ...data.columns.map((one) => {
      const values = members.map((row) => row.values[one.name]).filter((value) => value !== null && value !== undefined);
      const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
      return element("td", {}, values.length ? number(one.more ? mean : middle(values), one) : "–");
    }),
    ...["serious", "ambiguous"].map((flag) => element("td", {}, members.filter((row) => row.flags.includes(flag)).length))));
  const heads = ["", "results", ...data.columns.map((one) => `${one.more ? "mean" : "median"} ${one.name}, ${unitOf(one)}`), "serious", "ambiguous"];
  return element("table", { class: "summary" }, element("thead", {}, element("tr", {}, ...heads.map((words) => element("th", {}, words)))), element("tbody", {}, ...lines));
}

/** How many results there are, how many clips have none, and what is not shown. */
function facts(rows) {
  const { results, failed, left } = data.counts, all = results + failed + left, listed = data.rows.length;
  const words = [`${results} of ${all} results`];
  if (failed) words.push(`${failed} failed`);
  if (left) words.push(`${left} not done`);
  if (listed < all) words.push(`the worst ${listed} listed`);
  if (rows.length < listed) words.push(`${rows.length} shown`);
  return `${words.join(", ")}.${rows.some((row) => row.thumbnail) ? " Pictures show the frame of the lowest IOU." : ""}`;
}

const FIELDS = ["words", "sets", "flags", "by", "order", "form"];

/** Keep what is chosen in the address, so that it can be sent, and is back when one comes back from a result. */
function keepChosen() {
  const chosen = FIELDS.filter((id) => byId(id).value !== usual[id]).map((id) => [id, byId(id).value]);
  const hash = new URLSearchParams([...chosen, ...chosenBars]).toString();
  history.replaceState(null, "", hash ? `#${hash}` : location.pathname + location.search);
}

/** Choose what the address says, as far as it can be chosen here. */
function readChosen() {
  const said = new URLSearchParams(location.hash.slice(1));
  for (const id of FIELDS) {
    const value = said.get(id) ?? usual[id], known = byId(id).options;
    byId(id).value = !known || [...known].some((one) => one.value === value) ? value : usual[id];
  }
  chosenBars.clear();
  for (const { name, firsts } of HISTOGRAMS) {
    if (said.has(name) && firsts.includes(Number(said.get(name)))) chosenBars.set(name, Number(said.get(name)));
  }
}

let usual = {};

function show() {
  const all = found(), flag = byId("flags").value, some = all.filter((row) => flagged(row, flag));
  const rows = sorted(some.filter((row) => inBars(row)));
  const flags = [...byId("flags").options].slice(1), inAll = all.filter((row) => inBars(row));
  const counts = flags.map(({ value, text }) => ({ flag: value, words: text, count: inAll.filter((row) => flagged(row, value)).length }));
  const press = (value) => {
    byId("flags").value = value;
    show();
  };
  showHistograms([...HISTOGRAMS.map((one) => histogram(one, some.filter((row) => inBars(row, one)), show)), flagBars(counts, flag, press)]);
  keepChosen();
  byId("facts").textContent = facts(rows);
  byId("summary").replaceChildren(summary(rows));
  byId("rows").replaceChildren(byId("form").value === "table" ? table(rows) : gallery(rows));
}

function options(id, entries) {
  byId(id).append(...entries.map(([value, name]) => element("option", { value }, name)));
}

function start() {
  byId("title").textContent = data.title;
  const sets = [...new Set(data.rows.map((row) => row.set))].sort();
  options("sets", [["*", "all"], ...sets.map((set) => [set, set || "here"])]);
  byId("sets").parentElement.hidden = sets.length < 2;
  const used = new Set(data.rows.flatMap(flagsOf));
  options("flags", Object.entries(FLAGS).filter(([flag]) => ["any", "none"].includes(flag) || used.has(flag)));
  options("by", data.columns.map(({ name }) => [name, name]));
  if (column(data.first)) byId("by").value = data.first;
  usual = Object.fromEntries(FIELDS.map((id) => [id, byId(id).value]));
  for (const id of FIELDS) byId(id).addEventListener("input", show);
  addEventListener("hashchange", () => {
    readChosen();
    show();
  });
  readChosen();
  const tables = data.tables.flatMap(({ name, link }) => [element("a", { href: link }, name), " "]);
  byId("footer").append(`getagrip ${data.version}. `, ...(tables.length ? ["Tables: ", ...tables] : []));
  show();
  document.body.dataset.ready = "index";
}

start();
