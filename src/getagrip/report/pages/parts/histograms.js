"use strict";
// Histograms of the index, each bar of which is a button that filters the rows; a second press shows all again.

const STEPS = [1, 2, 5, 10], BARS = 10;  // widths of bars [%], and how many of them at most
const chosenBars = new Map();  // by the name of a column, the first per cent of the bar

/** The bars of a column: the first per cent of each, up to 100; of an IOU from below the least value on. */
function barsOf(name) {
  const known = data.rows.map((row) => row.values[name] ?? null).filter((value) => value !== null);
  const least = name === "IOU" ? 100 * Math.max(0, known.reduce((a, b) => Math.min(a, b), 0.99)) : 0;
  const step = STEPS.find((width) => Math.ceil((100 - least) / width) <= BARS), first = step * Math.floor(least / step);
  return { name, step, firsts: Array.from({ length: Math.ceil((100 - first) / step) }, (_, k) => first + k * step) };
}

const HISTOGRAMS = data.columns.filter(({ name }) => name === "IOU" || name.startsWith("probability"))
  .filter(({ name }) => data.rows.some((row) => Number.isFinite(row.values[name]))).map(({ name }) => barsOf(name));

/** The bar in which a value lies; 100 % is within the last one. */
function barOf({ step, firsts }, value) {
  if (value === null || value === undefined) return undefined;
  return firsts[Math.max(0, Math.min(firsts.length - 1, Math.floor((100 * value - firsts[0]) / step + 1e-9)))];
}

/** Whether a row lies in every bar that is pressed, but for one histogram's own. */
function inBars(row, except) {
  return HISTOGRAMS.every((one) => one === except || !chosenBars.has(one.name) || barOf(one, row.values[one.name]) === chosenBars.get(one.name));
}

function bar(words, count, most, pressed, press) {
  const said = `${words}: ${count} ${count === 1 ? "row" : "rows"}`;
  const made = element("button", { type: "button", class: "bar", title: said, "aria-label": said, "aria-pressed": String(pressed), onclick: press }, element("span"));
  made.firstChild.style.setProperty("--share", most ? count / most : 0);
  made.classList.toggle("empty", count === 0);
  return made;
}

/** A histogram of the rows that all other filters leave. */
function histogram(one, rows, changed) {
  const counts = new Map();
  for (const row of rows) counts.set(barOf(one, row.values[one.name]), (counts.get(barOf(one, row.values[one.name])) || 0) + 1);
  const most = Math.max(...one.firsts.map((first) => counts.get(first) || 0));
  const bars = one.firsts.map((first) => bar(`${one.name} ${first} to ${Math.min(100, first + one.step)} %`, counts.get(first) || 0, most, chosenBars.get(one.name) === first, () => {
    if (chosenBars.get(one.name) === first) chosenBars.delete(one.name);
    else chosenBars.set(one.name, first);
    changed();
  }));
  const ends = element("p", { class: "ends" }, element("span", {}, `${one.firsts[0]} %`), element("span", {}, "100 %"));
  return element("figure", {}, element("figcaption", {}, one.name), element("div", { class: "bars", role: "group", "aria-label": one.name }, ...bars), ends);
}

/** A bar for each flag, lying, with its words and count. */
function flagBars(counts, pressed, press) {
  const most = Math.max(...counts.map(({ count }) => count));
  const bars = counts.map(({ flag, words, count }) => {
    const made = bar(words, count, most, flag === pressed, () => press(flag === pressed ? "any" : flag));
    made.append(element("i", {}, words), element("b", {}, count));
    return made;
  });
  return element("figure", {}, element("figcaption", {}, "findings and status"), element("div", { class: "bars lying", role: "group", "aria-label": "findings and status" }, ...bars));
}

/** Show the histograms; the bar that has the focus keeps it. */
function showHistograms(figures) {
  const place = byId("histograms"), at = [...place.querySelectorAll("button")].indexOf(document.activeElement);
  place.replaceChildren(...figures);
  if (at >= 0) place.querySelectorAll("button")[at]?.focus();
}
