// Curves over the frames, with a cursor where the film is. A click goes there.

const plots = [];
const MOST_BINS = 800;

/** A curve; `values` is an array, or a function of what is selected that gives one, or null. */
function addPlot({ name, unit = "", values }) {
  plots.push({ name, unit, values });
}

function beginPlots() {
  const cursor = element("div", { className: "cursor" });
  const drawn = plots.map(({ name, unit, values }) => {
    const line = svg("path", { class: "line", "vector-effect": "non-scaling-stroke" });
    const picture = svg("svg", { viewBox: `0 0 ${view.count} 1`, preserveAspectRatio: "none", role: "img", "aria-label": `${name} over time` }, line);
    const least = element("span", { className: "least" }), most = element("span", { className: "most" });
    const now = element("output", {});
    const frame = element("div", { className: "curve" }, picture);
    frame.addEventListener("click", (event) => {
      const box = picture.getBoundingClientRect();
      view.show((event.clientX - box.left) / box.width * view.count - 0.5);
    });
    const whole = element("div", { className: "plot" },
      element("div", { className: "label" }, element("span", { textContent: name }), now, most, least), frame);
    byId("plots").append(whole);
    const one = { values: null, whole };
    one.take = (given) => {
      one.values = given;
      whole.hidden = given === null;
      if (given === null) return;
      const [low, high] = rangeOf(given);
      line.setAttribute("d", curve(given, low, high));
      least.textContent = short(low);
      most.textContent = short(high);
    };
    one.move = (i) => {
      const value = one.values?.[i];
      now.textContent = Number.isFinite(value) ? `${short(value)} ${unit}` : "–";
    };
    if (typeof values !== "function") one.take(values);
    else {
      one.take(null);
      view.on("select", (id) => { one.take(id === null ? null : values(id)); one.move(view.frame); });
    }
    return one;
  });
  byId("plots").append(cursor);
  view.on("frame", (i) => {
    cursor.style.setProperty("--at", (i + 0.5) / view.count);
    drawn.forEach((one) => one.move(i));
  });
}

function short(value) {
  if (Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 99.5 ? value.toFixed(0) : Number(value.toPrecision(3)).toString();
}

/** From 0 where nothing is below it, to the largest value. */
function rangeOf(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high) return [0, 1];
  low = low >= 0 ? 0 : low;
  return high > low ? [low, high] : [low, low + 1];
}

/** A path through the values, through lowest and highest of each bin where there are many; gaps where there are none. */
function curve(values, low, high) {
  const per = Math.max(1, Math.ceil(values.length / MOST_BINS));
  let path = "", pen = "M";
  const point = (k, value) => {
    path += `${pen}${k + 0.5} ${(1 - (value - low) / (high - low)).toFixed(4)}`;
    if (pen === "M") path += "h0"; // a dot, if nothing follows
    pen = "L";
  };
  for (let from = 0; from < values.length; from += per) {
    let least = -1, most = -1;
    for (let k = from; k < Math.min(from + per, values.length); k++) {
      if (!Number.isFinite(values[k])) continue;
      if (least < 0 || values[k] < values[least]) least = k;
      if (most < 0 || values[k] > values[most]) most = k;
    }
    if (least < 0) { pen = "M"; continue; }
    for (const k of new Set([Math.min(least, most), Math.max(least, most)])) point(k, values[k]);
  }
  return path;
}
