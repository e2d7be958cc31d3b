"use strict";
// Small plots over time; a click on one jumps to its frame.

class Plot {
  /** `times` are of all frames of the result, `segments` of a timeline; `jump` is called with the frame that is clicked. */
  constructor({ title, unit, lines, upTo, named }, times, segments, jump) {
    const [W, H, left, top, right, bottom] = [300, 130, 34, 6, 6, 18];
    const values = lines.flatMap((line) => line.values).filter((value) => value !== null);
    const [least, most] = upTo || [Infinity, -Infinity];
    let low = Math.min(...values, least), high = Math.max(...values, most);
    if (!(low <= high)) [low, high] = [0, 1];
    const margin = Math.max(0.06 * (high - low), 1e-3 * Math.max(1, Math.abs(high)));
    if (low !== least) low -= margin;
    if (high !== most) high += margin;
    if (low === high) high += 1;  // an error of zero throughout
    const last = Math.max(...times, 1e-9);
    this.x = (n) => left + ((W - left - right) * times[n]) / last;
    const y = (value) => H - bottom - ((H - top - bottom) * (value - low)) / (high - low);
    const plot = element("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": title });
    for (const tick of Plot.ticks(low, high)) {
      plot.append(
        element("line", { x1: left, x2: W - right, y1: y(tick), y2: y(tick), class: tick === 0 ? "zero" : "grid" }),
        element("text", { x: left - 5, y: y(tick) + 3.5, class: "left" }, String(tick)),
      );
    }
    const border = (n) => (this.x(Math.max(n - 1, 0)) + this.x(Math.min(n, times.length - 1))) / 2;  // before a frame
    for (const { colour, first, last: end } of segments) {
      const [x1, x2] = [border(first), border(end + 1)];
      plot.append(element("rect", { x: x1, y: H - bottom, width: x2 - x1, height: 3, fill: colour }));
      if (first) plot.append(element("line", { x1, x2: x1, y1: top, y2: H - bottom, class: "border" }));
    }
    for (const [n, words] of [[0, "0 s"], [times.length - 1, `${times[times.length - 1].toFixed(2)} s`]]) {
      plot.append(element("text", { x: this.x(n), y: H - 5, class: n ? "last" : "first" }, words));
    }
    lines.forEach((line) => {
      let path = "", drawing = false;
      line.values.forEach((value, n) => {
        if (value !== null) path += `${drawing ? "L" : "M"}${this.x(n).toFixed(1)} ${y(value).toFixed(1)}`;
        drawing = value !== null;
      });
      plot.append(element("path", { d: path, stroke: line.colour, class: line.dashed ? "curve dashed" : "curve" }));
    });
    this.cursor = element("line", { y1: top, y2: H - bottom, class: "cursor" });
    plot.append(this.cursor);
    this.value = element("b");
    this.lines = lines;
    this.unit = unit;
    if (named && lines.length > 1) {
      lines.forEach((line, k) => plot.append(element("text", { x: W / (k ? 1.9 : 2.1), y: H - 5, class: k ? "first" : "left", fill: line.colour }, line.name)));
    }
    this.figure = element("figure", { class: "plot" }, element("figcaption", {}, title, this.value), plot);
    const pick = (event) => {
      const box = plot.getBoundingClientRect();
      const time = (((event.clientX - box.left) / box.width) * W - left) / (W - left - right) * last;
      jump(times.reduce((best, t, n) => (Math.abs(t - time) < Math.abs(times[best] - time) ? n : best), 0));
    };
    plot.addEventListener("pointerdown", (event) => {
      plot.setPointerCapture(event.pointerId);
      pick(event);
    });
    plot.addEventListener("pointermove", (event) => event.buttons && pick(event));
  }

  /** Three to six round numbers. */
  static ticks(low, high) {
    const rough = (high - low) / 3, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [5, 2, 1].find((factor) => factor * power <= rough);
    const out = [];
    for (let n = Math.ceil(low / step); n * step <= high; n += 1) out.push(Number((n * step).toPrecision(6)));
    return out;
  }

  show(n) {
    this.cursor.setAttribute("x1", this.x(n));
    this.cursor.setAttribute("x2", this.x(n));
    const found = this.lines.filter(({ dashed }) => !dashed);
    const texts = found.map(({ values }) => (values[n] === null ? "not known" : values[n].toFixed(1)));
    const unit = texts.some((text) => text !== "not known") ? ` ${this.unit}` : "";
    if (found.length === 1) this.value.textContent = texts[0] + unit;
    else this.value.replaceChildren(...found.map(({ colour }, k) => this.coloured(texts[k], colour)), unit);
  }

  coloured(text, colour) {
    const out = element("span", {}, text);
    out.style.color = colour;
    return out;
  }
}
