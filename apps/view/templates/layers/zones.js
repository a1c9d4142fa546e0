// Zones and lines in which events are counted: drawn over the film, and drawn by the reader for a file of zones.

addLayers(({ zones, lines }) => {
  const shapes = [
    ...zones.map(({ name, polygon }) => ({ kind: "zone", name, points: polygon })),
    ...lines.map(({ name, from, to }) => ({ kind: "line", name, points: [from, to] })),
  ];
  const [width, height] = view.size;

  const trace = (pen, points) => {
    pen.beginPath();
    points.forEach((point) => pen.lineTo(...point));
  };
  /** From left to right of a line: the direction in which a crossing counts as such. */
  const drawArrow = (pen, [[x0, y0], [x1, y1]]) => {
    const long = Math.hypot(x1 - x0, y1 - y0) || 1, [rx, ry] = [-(y1 - y0) / long, (x1 - x0) / long];
    const size = 7 * pen.thin, [x, y] = [(x0 + x1) / 2 + 2.5 * size * rx, (y0 + y1) / 2 + 2.5 * size * ry];
    pen.beginPath();
    pen.moveTo((x0 + x1) / 2, (y0 + y1) / 2);
    pen.lineTo(x, y);
    pen.moveTo(x - size * (rx + ry), y - size * (ry - rx));
    pen.lineTo(x, y);
    pen.lineTo(x - size * (rx - ry), y - size * (ry + rx));
    pen.stroke();
  };
  /** Above the upper end, where there is room in the picture. */
  const aboveLine = (points, size) => {
    const [x, y] = points[0][1] < points[1][1] ? points[0] : points[1];
    return [x, Math.max(y - 0.8 * size, 0.6 * size)];
  };
  const drawShape = (pen, { kind, name, points }) => {
    pen.strokeStyle = "#ffd23f";
    pen.lineWidth = 2 * pen.thin;
    trace(pen, points);
    if (kind === "zone") {
      pen.closePath();
      pen.fillStyle = "rgb(255 210 63 / .12)";
      pen.fill();
    }
    pen.stroke();
    if (kind === "line") drawArrow(pen, points);
    const size = 12 * pen.thin;
    pen.font = `600 ${size}px system-ui, sans-serif`;
    const x = points.reduce((sum, point) => sum + point[0], 0) / points.length;
    const y = points.reduce((sum, point) => sum + point[1], 0) / points.length;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineWidth = 3 * pen.thin;
    pen.strokeStyle = "rgb(0 0 0 / .75)";
    pen.fillStyle = "#ffe48a";
    const place = kind === "line" ? aboveLine(points, size) : [x, y];
    pen.strokeText(name, ...place);
    pen.fillText(name, ...place);
  };
  addSwitch({
    name: "zones", label: "zones and lines", key: "l",
    draw(pen) { shapes.forEach((shape) => drawShape(pen, shape)); },
  });

  // --- drawing more of them ---

  const list = element("ul", { className: "shapes" });
  const hint = element("p", { className: "quiet", "aria-live": "polite" });
  const toml = element("textarea", { readOnly: true, rows: 7, spellcheck: false, "aria-label": "File of zones, TOML" });
  const copy = element("button", { textContent: "Copy" }), save = element("button", { textContent: "Download" });
  const file = element("div", {}, toml, element("div", { className: "buttons" }, copy, save));
  const draw = ["zone", "line"].map((kind) => {
    const button = element("button", { textContent: `Draw a ${kind}`, id: `draw-${kind}` });
    button.addEventListener("click", () => begin(kind));
    return button;
  });
  addPanel("Zones and lines").append(element("div", { className: "buttons" }, ...draw), hint, list, file);

  const inside = ([x, y]) => [clamped(x, 0, width), clamped(y, 0, height)].map((v) => Math.round(10 * v) / 10);
  const free = (name, but = null) => {
    const taken = shapes.filter((shape) => shape !== but).map((shape) => shape.name);
    if (name && !taken.includes(name)) return name;
    for (let k = 1; ; k++) if (!taken.includes(`${name} ${k}`.trim())) return `${name} ${k}`.trim();
  };
  const show = () => {
    list.replaceChildren(...shapes.map(item));
    file.hidden = !shapes.length;
    toml.value = inToml(shapes);
    view.redraw();
  };
  const item = (shape) => {
    const name = element("input", { type: "text", value: shape.name, "aria-label": `name of the ${shape.kind}` });
    const points = element("input", {
      type: "text", value: shape.points.map((point) => point.join(",")).join(" "), "aria-label": `corners of ${shape.name}, px`,
    });
    const remove = element("button", { textContent: "×", title: `Remove ${shape.name}`, "aria-label": `Remove ${shape.name}` });
    name.addEventListener("change", () => { shape.name = free(name.value.trim(), shape); show(); });
    points.addEventListener("change", () => {
      const typed = points.value.trim().split(/\s+/).map((point) => point.split(",").map(Number));
      const sound = typed.every((point) => point.length === 2 && point.every(Number.isFinite));
      if (sound && (shape.kind === "zone" ? typed.length > 2 : typed.length === 2)) shape.points = typed.map(inside);
      show();
    });
    remove.addEventListener("click", () => { shapes.splice(shapes.indexOf(shape), 1); show(); draw[0].focus(); });
    return element("li", {}, name, remove, points);
  };

  /** Clicks on the film are corners, until the shape is complete. */
  const begin = (kind) => {
    const points = [];
    let next = null;
    const end = () => {
      document.removeEventListener("keydown", key, true);
      hint.textContent = "";
      useTool(null);
    };
    const finish = () => {
      const wanted = kind === "zone" ? 3 : 2;
      const made = points.length >= wanted ? points : usual(kind);
      shapes.push({ kind, name: free(kind), points: made.map(inside) });
      end();
      show();
      list.lastElementChild.querySelector("input").select();
    };
    const key = (event) => {
      if (event.key !== "Enter" && event.key !== "Escape") return;
      event.preventDefault();
      event.stopPropagation();
      if (event.key === "Enter") finish(); else end();
    };
    useTool({
      click(x, y, thin) {
        const back = points.length > 2 && Math.hypot(x - points[0][0], y - points[0][1]) < 10 * thin;
        const again = points.length && Math.hypot(x - points.at(-1)[0], y - points.at(-1)[1]) < 3 * thin;
        if (back) { finish(); return; }
        if (!again) points.push([x, y]);
        if (kind === "line" && points.length === 2) finish(); else view.redraw();
      },
      move(x, y) { next = [x, y]; view.redraw(); },
      finish() { if (points.length > 2) finish(); },
      draw(pen) {
        pen.save();
        pen.strokeStyle = pen.fillStyle = "#ffd23f";
        pen.lineWidth = 2 * pen.thin;
        trace(pen, next ? [...points, next] : points);
        pen.stroke();
        for (const [x, y] of points) {
          pen.beginPath();
          pen.arc(x, y, 4 * pen.thin, 0, 2 * Math.PI);
          pen.fill();
        }
        pen.restore();
      },
    });
    document.addEventListener("keydown", key, true);
    hint.textContent = kind === "zone"
      ? "Click the corners; a double click or Enter closes the zone, Escape cancels. Enter at once adds one to be typed."
      : "Click both ends: crossings are from its left to its right, or back. Enter at once adds one to be typed.";
  };
  const usual = (kind) => {
    const [x, y] = [width / 4, height / 4];
    return kind === "zone" ? [[x, y], [3 * x, y], [3 * x, 3 * y], [x, 3 * y]] : [[x, 2 * y], [3 * x, 2 * y]];
  };

  copy.addEventListener("click", async () => {
    toml.select();
    try { await navigator.clipboard.writeText(toml.value); } catch { document.execCommand("copy"); }
    hint.textContent = "Copied.";
  });
  save.addEventListener("click", () => {
    const address = URL.createObjectURL(new Blob([toml.value], { type: "application/toml" }));
    element("a", { href: address, download: "zones.toml" }).click();
    URL.revokeObjectURL(address);
  });
  show();
});

function inToml(shapes) {
  const point = ([x, y]) => `[${x}, ${y}]`;
  return shapes.map(({ kind, name, points }) => `[[${kind}]]\nname = ${JSON.stringify(name)}\n` + (kind === "zone"
    ? `polygon = [${points.map(point).join(", ")}]\n`
    : `from = ${point(points[0])}\nto = ${point(points[1])}\n`)).join("\n");
}
