// The film and the canvas over it. A pen's unit is a px of the source, whatever the size on the screen.

const switches = [];

/**
 * Something that is drawn over the film and can be switched off.
 * `draw(pen, i)` draws frame i. `hit(x, y, i)`, if any, gives the id of what is at a place of the source, or
 * null; `place(id, i)` gives where it is, [x, y, width, height], or null, for the zoom that follows it.
 */
function addSwitch({ name, label = name, key = null, on = true, draw, hit = null, place = null }) {
  const box = element("input", { type: "checkbox", checked: on });
  const one = { name, box, draw, hit, place };
  box.addEventListener("change", () => view.redraw());
  const hint = key ? [element("kbd", { textContent: key, "aria-hidden": "true" })] : [];
  byId("switches").append(
    element("label", { className: "switch" }, box, element("span", { textContent: label }), ...hint));
  if (key) addKey(key, `show or hide ${label}`, () => box.click());
  switches.push(one);
  return one;
}

/** What takes clicks on the film in the place of selecting: `click(x, y)`, `move(x, y)`, `finish()`. */
let tool = null;
function useTool(other) {
  tool = other;
  byId("drawing").classList.toggle("drawing", tool !== null);
  view.redraw();
}

const ZOOM_SECONDS = 0.4; // to both sides, over which the place that is followed is averaged
const MOST_ZOOM = 6;

/** The part of the source that is shown, in which the box takes five eighths at most: [x, y, zoom]. */
function lensOf(id, i) {
  const [width, height] = view.size;
  const place = (k) => switches.map((one) => one.place?.(id, k)).find(Boolean);
  const here = place(i);
  if (!here) return [0, 0, 1];
  const zoom = clamped(Math.min(width / here[2], height / here[3]) / 1.6, 1, MOST_ZOOM);
  let x = 0, y = 0, n = 0;
  for (let k = i; k >= 0 && view.times[i] - view.times[k] <= ZOOM_SECONDS; k--) sum(k);
  for (let k = i + 1; k < view.count && view.times[k] - view.times[i] <= ZOOM_SECONDS; k++) sum(k);
  function sum(k) {
    const there = place(k);
    if (there) { x += there[0] + there[2] / 2; y += there[1] + there[3] / 2; n++; }
  }
  const middle = [width / zoom / 2, height / zoom / 2];
  return [
    clamped(x / n - middle[0], 0, width - 2 * middle[0]), clamped(y / n - middle[1], 0, height - 2 * middle[1]), zoom,
  ];
}

function beginStage() {
  const stage = byId("stage"), canvas = byId("drawing"), pen = canvas.getContext("2d"), video = byId("video");
  const [width, height] = view.size;
  let lens = [0, 0, 1], follow = null, fresh = false;
  stage.style.setProperty("--ratio", `${width} / ${height}`);
  stage.style.setProperty("--width-per-height", width / height);

  // the film's sides are even: where those of the source are odd, it has a column or row more
  let [wide, high] = [width, height];
  video?.addEventListener("loadedmetadata", () => {
    [wide, high] = [Math.max(width, video.videoWidth), Math.max(height, video.videoHeight)];
    [video.style.width, video.style.height] = [`${100 * wide / width}%`, `${100 * high / height}%`];
  });

  const draw = () => {
    fresh = false;
    const i = view.frame;
    lens = follow?.checked && view.selected !== null ? lensOf(view.selected, i) : [0, 0, 1];
    const [x, y, zoom] = lens;
    if (video) video.style.transform = `scale(${zoom}) translate(${-100 * x / wide}%, ${-100 * y / high}%)`;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.setTransform(zoom * canvas.width / width, 0, 0, zoom * canvas.height / height,
      -x * zoom * canvas.width / width, -y * zoom * canvas.height / height);
    pen.thin = (window.devicePixelRatio || 1) * width / canvas.width / zoom;
    pen.lineJoin = "round";
    for (const one of switches) {
      if (!one.box.checked) continue;
      pen.save();
      one.draw(pen, i);
      pen.restore();
    }
    tool?.draw?.(pen);
  };
  const fit = () => {
    const box = stage.getBoundingClientRect(), fine = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(box.width * fine));
    canvas.height = Math.max(1, Math.round(box.height * fine));
    draw();
  };
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect(), [x, y, zoom] = lens;
    return [
      x + (event.clientX - box.left) * width / box.width / zoom, y + (event.clientY - box.top) * height / box.height / zoom,
    ];
  };
  const hitAt = ([x, y]) => {
    for (const one of [...switches].reverse()) {
      const id = one.box.checked && one.hit ? one.hit(x, y, view.frame) : null;
      if (id !== null) return id;
    }
    return null;
  };
  canvas.addEventListener("click", (event) => {
    const place = placeOf(event);
    if (tool) tool.click(...place, pen.thin); else view.select(hitAt(place));
  });
  canvas.addEventListener("dblclick", () => tool?.finish());
  canvas.addEventListener("mousemove", (event) => {
    const place = placeOf(event);
    if (tool) tool.move(...place); else canvas.style.cursor = hitAt(place) === null ? "" : "pointer";
  });
  if (switches.some((one) => one.place)) {
    follow = element("input", { type: "checkbox", id: "follow" });
    follow.addEventListener("change", draw);
    byId("switches").append(element("label", { className: "switch apart" }, follow,
      element("span", { textContent: "zoom on what is selected" }), element("kbd", { textContent: "z", "aria-hidden": "true" })));
    addKey("z", "zoom on what is selected, and follow it", () => follow.click());
  }
  view.on("draw", () => { // once, however much has changed
    if (!fresh) requestAnimationFrame(draw);
    fresh = true;
  });
  new ResizeObserver(fit).observe(stage);
}
