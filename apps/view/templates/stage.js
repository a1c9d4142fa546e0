// The film and the canvas over it. A pen's unit is a px of the source, whatever the size on the screen.

const switches = [];

/**
 * Something that is drawn over the film and can be switched off.
 * `draw(pen, i)` draws frame i; `hit(x, y, i)`, if any, gives the id of what is at a place of the source, or null.
 */
function addSwitch({ name, label = name, key = null, on = true, draw, hit = null }) {
  const box = element("input", { type: "checkbox", checked: on });
  const one = { name, box, draw, hit };
  box.addEventListener("change", () => view.redraw());
  const hint = key ? [element("kbd", { textContent: key })] : [];
  byId("switches").append(element("label", { className: "switch" }, box, element("span", { textContent: label }), ...hint));
  if (key) addKey(key, `show or hide ${label}`, () => box.click());
  switches.push(one);
  return one;
}

function beginStage() {
  const stage = byId("stage"), canvas = byId("drawing"), pen = canvas.getContext("2d");
  const [width, height] = view.size;
  stage.style.setProperty("--ratio", `${width} / ${height}`);
  stage.style.setProperty("--width-per-height", width / height);

  const fit = () => {
    const box = stage.getBoundingClientRect(), fine = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(box.width * fine));
    canvas.height = Math.max(1, Math.round(box.height * fine));
    view.redraw();
  };
  const draw = (i) => {
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
    pen.thin = (window.devicePixelRatio || 1) * width / canvas.width;
    for (const one of switches) {
      if (!one.box.checked) continue;
      pen.save();
      one.draw(pen, i);
      pen.restore();
    }
  };
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * width / box.width, (event.clientY - box.top) * height / box.height];
  };
  const hitAt = ([x, y]) => {
    for (const one of switches.toReversed()) {
      const id = one.box.checked && one.hit ? one.hit(x, y, view.frame) : null;
      if (id !== null) return id;
    }
    return null;
  };
  canvas.addEventListener("click", (event) => view.select(hitAt(placeOf(event))));
  canvas.addEventListener("mousemove", (event) => {
    canvas.style.cursor = hitAt(placeOf(event)) === null ? "default" : "pointer";
  });
  view.on("draw", draw);
  new ResizeObserver(fit).observe(stage);
}
