"use strict";
// A column of the page: what is said of a result, its 3D view, and its image with contours.

/** A labelled box that is on or off; `key` of the keyboard turns it as well. */
function toggle(words, on, change, { colour, key } = {}) {
  const box = element("input", { type: "checkbox", "aria-keyshortcuts": key, onchange: () => change(box.checked) });
  box.checked = on;
  const label = element("label", { title: key }, box, words);
  if (colour) label.style.setProperty("--key", colour);
  if (colour) label.className = "keyed";
  return label;
}

function choice(words, values, change) {
  const select = element("select", { onchange: () => change(select.value) }, ...values.map(([value, name]) => element("option", { value }, name)));
  return element("label", {}, `${words} `, select);
}

const list = (items) => element("ul", {}, ...items.map((item) => element("li", {}, item)));

function table(head, rows, chosen) {
  const lines = rows.map(([name, ...values], k) => element("tr", { class: k === chosen && "chosen" }, element("th", {}, name), ...values.map((value) => element("td", {}, value))));
  if (head.length) lines.unshift(element("tr", {}, ...head.map((name) => element("th", {}, name))));
  return element("table", {}, ...lines);
}

/** An image with contours over it, in an element of the page. */
class Footage {
  constructor(place, size, colours) {
    this.part = (name) => place.querySelector(name);
    this.paths = {};
    this.part("svg").setAttribute("viewBox", `0 0 ${size} ${size}`);
    for (const name of ["observed", "hand", "true", "object"]) {
      const [halo, line] = ["halo", "line"].map((kind) => element("path", { class: kind, stroke: kind === "line" ? colours[name] : "#fff" }));
      this.paths[name] = element("g", { class: name }, halo, line);
      this.part("svg").append(this.paths[name]);
    }
  }

  show({ picture, place, outlines }) {
    this.part(".picture").setAttribute("href", `data:image/jpeg;base64,${picture}`);
    ["x", "y", "width", "height"].forEach((name, k) => this.part(".picture").setAttribute(name, place[k]));
    for (const [name, group] of Object.entries(this.paths)) {
      for (const path of group.children) path.setAttribute("d", outlines[name] || "");
    }
  }

  turn(name, on) {
    if (this.paths[name]) this.paths[name].setAttribute("visibility", on ? "visible" : "hidden");
  }
}

class Column {
  /** `said` is what the server says of it; `changed` is called when another candidate is chosen. */
  constructor(said, arrays, source, eye, { size, sizeOfViews, colours, colour, changed }) {
    Object.assign(this, { said, arrays, source, colour, rank: 0 });
    this.article = byId("column").content.firstElementChild.cloneNode(true);
    this.part = (name) => this.article.querySelector(name);
    this.head();
    this.footage = new Footage(this.article, size, colours);
    this.views = said.views.map((name, k) => this.view(name, k, eye, sizeOfViews, colours));
    this.below(changed);
    byId("columns").append(this.article);
    try {
      this.viewer = new Viewer(this.part(".scene"), arrays, eye);
    } catch (error) {
      this.part(".scene").hidden = true;
      this.part(".no-scene").hidden = false;
    }
  }

  /** The words at the top, and what speaks against the result. */
  head() {
    const { label, facts, status, main, findings, ambiguous, candidates } = this.said;
    this.part("h2").textContent = label;
    if (this.colour) this.part("h2").style.setProperty("--key", this.colour);
    this.part(".facts").textContent = facts.join("  ·  ");
    this.part(".status").textContent = status;
    for (const { name, value, meaning } of main) {
      this.part(".main").append(element("div", { title: meaning }, element("dd", {}, value), element("dt", {}, name)));
    }
    const shown = candidates.length > 1 ? "; the candidates below show it" : "";  // of a timeline there is one only
    const other = { check: "ambiguous", message: `another pose explains the masks almost as well${shown}` };
    this.findings("serious", "serious finding", findings.filter(({ serious }) => serious));
    this.findings("note", "note", [...(ambiguous ? [other] : []), ...findings.filter(({ serious }) => !serious)]);
  }

  /** What speaks against the result, folded; open if it is serious. */
  findings(kind, words, found) {
    if (!found.length) return;
    const checks = [...new Set(found.map(({ check }) => check))].join(", ");
    const summary = element("summary", {}, element("b", {}, `${found.length} ${words}${found.length > 1 ? "s" : ""}`), ` ${checks}`);
    const messages = found.map(({ check, message }) => element("li", {}, element("b", {}, check), ` ${message}`));
    this.part(".warnings").append(element("details", { class: kind, open: kind === "serious" }, summary, element("ul", { tabindex: 0 }, ...messages)));
  }

  /** The footage of a further view; a click on its name looks from its camera. */
  view(name, k, eye, size, colours) {
    const figure = byId("view").content.firstElementChild.cloneNode(true), button = figure.querySelector("button");
    button.textContent = name;
    button.title = "look from this camera";
    button.onclick = () => eye.choose(`view ${k}`);
    button.style.setProperty("--key", cameraColour(k + 1));
    figure.querySelector("svg").setAttribute("aria-label", `the image of ${name}`);
    this.part(".views").append(figure);
    this.part(".views").hidden = false;
    return { footage: new Footage(figure, size, colours), met: figure.querySelector(".met") };
  }

  /** The choice among the candidates, and what speaks for and against each. */
  below(changed) {
    const { candidates, result } = this.said, below = this.part(".below");
    const other = element("p", { class: "other", hidden: true }, "Shown is another candidate. Plots and numbers are those of the result.");
    const compared = element("details", {}, element("summary", {}, "Compare the candidates"), element("div", {}, "measuring ..."));
    let known = null;
    const compare = () => known && compared.lastChild.replaceChildren(...this.comparison(known));
    compared.ontoggle = async () => {
      if (!compared.open || known) return;
      try {
        known = await this.source.candidates();
        compare();
      } catch (error) {
        compared.lastChild.textContent = error.message;
      }
    };
    if (candidates.length > 1) {
      const names = candidates.map(({ energy }, k) => [k, `${k ? `candidate ${k + 1}` : "the result"}, energy ${Number(energy.toPrecision(4))}`]);
      below.append(choice("pose", names, (value) => {
        this.rank = Number(value);
        other.hidden = this.rank === 0;
        compare();
        changed();
      }));
    }
    below.append(other);
    if (this.source.candidates && result) below.append(compared);
  }

  comparison({ head, rows, pros, cons }) {
    const parts = [table(head, rows, this.rank)];
    for (const [words, texts] of [["Speaks for it", pros[this.rank]], ["Speaks against it", cons[this.rank]]]) {
      if (texts.length) parts.push(element("b", {}, words), list(texts));
    }
    if (rows.length === 1) parts.push(element("p", {}, "No other distinct candidate was found to compare it with."));
    return parts;
  }

  /** What is folded below the plots. */
  more(several) {
    const { label, notes, tables } = this.said;
    const words = notes.length ? [element("div", { class: "notes" }, element("h3", {}, "Guesses and notes"), list(notes))] : [];
    const folded = tables.map(({ title, head, rows }) => element("details", {}, element("summary", {}, title), table(head, rows)));
    return element("section", {}, ...(several ? [element("h2", {}, label)] : []), ...words, element("div", { class: "tables" }, ...folded));
  }

  frame(place) {
    return this.source.frame(this.rank, place);
  }

  show(place, { views, arrays, ...own }) {
    this.unread("");
    this.footage.show(own);
    this.views.forEach(({ footage, met }, k) => {
      footage.show(views[k]);
      met.textContent = views[k].met || "";
    });
    if (this.viewer) this.viewer.show(place, this.rank, arrays);
  }

  /** Say why a frame cannot be shown. */
  unread(words) {
    this.part(".unread").textContent = words;
    this.part(".unread").hidden = !words;
  }

  /** Show or hide a part, in 3D and among the contours. */
  turn(name, on) {
    if (this.viewer) {
      this.viewer.shown[name] = on;
      this.part(".measures").textContent = this.viewer.measures();
      this.part(".measures").hidden = !this.viewer.measures();
    }
    for (const footage of [this.footage, ...this.views.map((view) => view.footage)]) footage.turn(name, on);
  }
}
