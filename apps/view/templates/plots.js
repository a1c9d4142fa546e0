// Plots with axes, ticks and units. Those over the frames of the run show where the film is; a click goes there.

const PLOT_HEIGHT = 150, MAP_RATIO = 1.25; // px of the page; the most that a map is higher than wide
const ROOM = { left: 54, right: 12, top: 8, bottom: 34 };
const MOST_BINS = 800;
const plots = [];

/** A curve over the film's frames of what is selected: `values(id)` gives an array, or null where there is none. */
function addPlot({ name, unit = "", values }) {
  const figure = element("figure", { className: "plot", hidden: true });
  byId("plots").append(figure);
  const drawn = new DrawnPlot(figure, null);
  plots.push(drawn);
  view.on("select", (id) => {
    const given = id === null ? null : values(id);
    drawn.show(given === null ? null : {
      name, unit, axis: null, caption: "", shaded: [], dotted: [], isMap: false,
      lines: [{ label: "", colour: "var(--accent)", style: "line", values: given, band: null, x: filmAxis(), colours: null }],
    });
  });
}

function beginPlots() {
  document.querySelectorAll("figure[data-plot]").forEach((figure) => {
    plots.push(new DrawnPlot(figure, data.plots[figure.dataset.plot]));
  });
  if (!plots.length) return;
  const seen = new ResizeObserver((entries) => entries.forEach(({ target }) => target.drawn.draw()));
  for (const plot of plots) seen.observe(plot.figure);
  view.on("frame", () => plots.forEach((plot) => plot.move()));
}

class DrawnPlot {
  constructor(figure, plot) {
    Object.assign(this, { figure, plot: null, width: 0, scale: null });
    figure.drawn = this;
    this.show(plot);
  }

  show(plot) {
    this.plot = plot;
    this.width = 0;
    this.figure.hidden = plot === null;
    if (plot === null) return;
    const { name, unit, lines, caption, axis, isMap } = plot;
    this.figure.classList.toggle("map", isMap);
    this.moves = axis === null && view.count > 0;
    this.figure.classList.toggle("moves", this.moves);
    const legend = lines.filter(({ label }) => label);
    this.values = lines.map(() => element("output", {}));
    const head = element("div", { className: "head" }, element("b", { textContent: name }));
    if (!legend.length && this.moves) head.append(this.values[0]);
    lines.forEach(({ label, colour }, k) => {
      if (!label) return;
      const one = element("span", {}, element("i", { style: `background:${colour}` }), label);
      if (this.moves) one.append(" ", this.values[k]);
      head.append(one);
    });
    head.append(element("span", { className: "quiet", textContent: data.title }));
    const along = axis ?? (data.over === "time" ? "time in the film, s" : "frame");
    this.svg = svg("svg", { role: "img", "aria-label": `${name}${unit ? `, ${unit}` : ""} over ${along}` });
    this.along = along;
    this.svg.addEventListener("click", (event) => this.click(event));
    this.figure.replaceChildren(head, this.svg);
    if (caption) this.figure.append(element("figcaption", { textContent: caption }));
    this.draw();
    this.move();
  }

  /** Draw it as wide as its room is, if that has changed. */
  draw() {
    const width = Math.round(this.figure.clientWidth);
    if (this.plot === null || !width || width === this.width) return;
    this.width = width;
    const { lines, unit, isMap, shaded, dotted } = this.plot;
    const xs = lines.map((line) => line.x ?? runAxis());
    let across = rangeOf(this.moves ? [...xs, runAxis()] : xs), along = rangeOf(lines.flatMap(({ values, band }) => [values, ...(band ?? [])]));
    // where there is room, plots over the film are aligned with the rows of what is followed
    const left = this.moves && width > 700 ? parseFloat(getComputedStyle(byId("plots")).getPropertyValue("--label")) : ROOM.left;
    const inner = width - left - ROOM.right;
    let high = PLOT_HEIGHT - ROOM.top - ROOM.bottom;
    if (isMap) {
      [across, along] = [widened(across, 0.05), widened(along, 0.05)];
      const ratio = (along[1] - along[0]) / (across[1] - across[0]);
      high = Math.round(inner * Math.min(ratio, MAP_RATIO));
      if (ratio > MAP_RATIO) across = widened(across, (ratio / MAP_RATIO - 1) / 2);
      along = [along[1], along[0]]; // down
    } else {
      along = fromZero(along);
      if (this.plot.axis !== null) across = widened(across, 0.02);
    }
    const [x0, x1] = across, [y0, y1] = along;
    const x = (value) => left + (value - x0) / (x1 - x0) * inner;
    const y = (value) => ROOM.top + (y1 - value) / (y1 - y0) * high;
    this.scale = { left, x0, x1, inner, reach: Math.max(Math.abs(y0), Math.abs(y1)) };
    const parts = [];
    const text = (value, at, attributes = {}) => {
      const [column, row] = at;
      parts.push(svg("text", { x: column, y: row, ...attributes }, value));
    };
    const areWhole = (arrays) => arrays.every((values) => values.every((value) => Number.isInteger(value) || Number.isNaN(value)));
    for (const value of ticks(Math.min(y0, y1), Math.max(y0, y1), high / 28, areWhole(lines.map(({ values }) => values)))) {
      parts.push(svg("path", { class: "grid", d: `M${left} ${y(value).toFixed(1)}h${inner}` }));
      text(short(value), [left - 6, y(value) + 4], { "text-anchor": "end" });
    }
    const bottom = ROOM.top + high;
    for (const value of ticks(x0, x1, inner / 70, areWhole(xs))) {
      parts.push(svg("path", { class: "grid", d: `M${x(value).toFixed(1)} ${bottom}v4` }));
      text(short(value), [x(value), bottom + 16], { "text-anchor": "middle" });
    }
    parts.push(svg("path", { class: "grid", d: `M${left} ${ROOM.top}V${bottom}h${inner}` }));
    text(this.along, [left + inner / 2, bottom + 30], { "text-anchor": "middle" });
    text(unit, [0, 0], { transform: `translate(${left - 43} ${ROOM.top + high / 2}) rotate(-90)`, "text-anchor": "middle" });
    const inside = (value) => clamped(x(value), left, left + inner);
    for (const [from, to] of shaded) {
      parts.push(svg("rect", { class: "shaded", x: inside(from), y: ROOM.top, width: Math.max(1, inside(to) - inside(from)), height: high }));
    }
    for (const at of dotted) parts.push(svg("path", { class: "dotted", d: `M${x(at)} ${ROOM.top}v${high}` }));
    lines.forEach((line, k) => parts.push(...drawnLine(line, xs[k], x, y)));
    this.svg.setAttribute("viewBox", `0 0 ${width} ${bottom + ROOM.bottom}`);
    this.cursor = svg("path", { class: "cursor" });
    this.svg.replaceChildren(...parts, this.cursor);
    this.high = high;
    this.move();
  }

  /** Show the frame that the film is at. */
  move() {
    if (this.plot === null || !this.moves || !this.scale) return;
    const at = filmAxis()[view.frame], { left, x0, x1, inner } = this.scale;
    const place = left + (at - x0) / (x1 - x0) * inner;
    this.cursor.setAttribute("d", `M${clamped(place, left, left + inner).toFixed(1)} ${ROOM.top}v${this.high}`);
    this.plot.lines.forEach(({ values, x }, k) => {
      const value = values[lastAtMost(x ?? runAxis(), at + 1e-6)];
      const told = Math.abs(value) < 1e-6 * this.scale.reach ? 0 : value; // of what is rounded off
      this.values[k].textContent = Number.isFinite(value) ? `${short(told)} ${this.plot.unit}` : "–";
    });
  }

  click(event) {
    if (!this.moves) return;
    const box = this.svg.getBoundingClientRect(), { left, x0, x1, inner } = this.scale;
    const at = ((event.clientX - box.left) * this.width / box.width - left) / inner;
    const wanted = x0 + at * (x1 - x0), axis = filmAxis(), i = lastAtMost(axis, wanted);
    view.show(i + 1 < view.count && axis[i + 1] - wanted < wanted - axis[i] ? i + 1 : i);
  }
}

/** Where the frames of the run, and those of the film, are on the horizontal axis. */
function runAxis() {
  return data.over === "time" ? data.run.times : data.run.numbers;
}

function filmAxis() {
  return data.over === "time" ? view.times : view.numbers;
}

function drawnLine({ values, band, colour, style, colours }, xs, x, y) {
  const parts = [];
  if (band) {
    const edge = (bound, k) => `${x(xs[k]).toFixed(1)} ${y(bound[k]).toFixed(1)}`;
    let path = "";
    for (let from = 0; from < values.length; from++) {
      if (!Number.isFinite(band[0][from])) continue;
      let to = from;
      while (to + 1 < values.length && Number.isFinite(band[0][to + 1])) to++;
      const there = [], back = [];
      for (let k = from; k <= to; k++) { there.push(edge(band[0], k)); back.unshift(edge(band[1], k)); }
      path += `M${[...there, ...back].join("L")}Z`;
      from = to;
    }
    parts.push(svg("path", { class: "band", d: path, fill: colour }));
  }
  if (style === "dots") {
    const radius = values.length > 300 ? 1.6 : 3;
    values.forEach((value, k) => {
      if (!Number.isFinite(value) || !Number.isFinite(xs[k])) return;
      parts.push(svg("circle", { cx: x(xs[k]).toFixed(1), cy: y(value).toFixed(1), r: radius, fill: colours?.[k] ?? colour }));
    });
    return parts;
  }
  parts.push(svg("path", { class: "line", d: curve(values, xs, x, y, style === "steps"), stroke: colour }));
  return parts;
}

/** A path through the values, through lowest and highest of each bin where there are many; gaps where there are none. */
function curve(values, xs, x, y, steps) {
  const per = steps ? 1 : Math.max(1, Math.ceil(values.length / MOST_BINS));
  let path = "", pen = "M", last = 0;
  const point = (k) => {
    const column = x(xs[k]).toFixed(1), row = y(values[k]).toFixed(1);
    if (steps && pen === "L") path += `L${column} ${last}`;
    path += `${pen}${column} ${row}`;
    if (pen === "M") path += "h0"; // a dot, if nothing follows
    [pen, last] = ["L", row];
  };
  const isKnown = (k) => Number.isFinite(values[k]) && Number.isFinite(xs[k]);
  for (let from = 0; from < values.length; from += per) {
    let least = -1, most = -1;
    for (let k = from; k < Math.min(from + per, values.length); k++) {
      if (!isKnown(k)) continue;
      if (least < 0 || values[k] < values[least]) least = k;
      if (most < 0 || values[k] > values[most]) most = k;
    }
    if (least < 0) { pen = "M"; continue; }
    for (const k of new Set([Math.min(least, most), Math.max(least, most)])) point(k);
  }
  return path;
}

function short(value) {
  if (Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 99.5 ? value.toFixed(0) : Number(value.toPrecision(3)).toString();
}

/** Least and largest of what is known in several arrays. */
function rangeOf(arrays) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) {
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) return [0, 1];
  return high > low ? [low, high] : [low - 0.5, low + 0.5];
}

/** From 0 where nothing is below it and it is not far away; and a little room above. */
function fromZero([low, high]) {
  const room = 0.08 * (high - low);
  if (low >= 0 && low < 2 * (high - low)) return [0, high + 0.08 * high];
  return [low - room, high + room];
}

function widened([low, high], share) {
  const room = share * (high - low);
  return [low - room, high + room];
}

/** Round numbers between two, about so many of them. */
function ticks(low, high, count, whole) {
  const rough = (high - low) / Math.max(count, 2), size = 10 ** Math.floor(Math.log10(rough));
  const step = Math.max([1, 2, 5, 10].map((k) => k * size).find((each) => each >= rough), whole ? 1 : 0);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
}
