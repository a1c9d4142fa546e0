// A shape that deforms, in space: as it is in the frame, or one of its modes, which is moved by hand.

addLayers(({ bases, triangles, inks, rotations, scales, weights, depths, tracked, size, reach }) => {
  const [nBases, nPoints] = bases.shape, nModes = nBases - 1;
  const MOST = 3; // standard deviations of a mode
  const BODY = 0xc8b8a8;
  const panel = addPanel("In space");
  const names = ["as in the film", "mean shape", ...Array.from({ length: nModes }, (_, k) => `mode ${k + 1}`)];
  const which = element("select", { "aria-label": "Which shape" }, ...names.map((name, k) => new Option(name, k)));
  const withFilm = element("input", { type: "checkbox", checked: true });
  const asSurface = element("input", { type: "checkbox" });
  const amount = element("input", { type: "range", min: -MOST, max: MOST, step: 0.05, value: 2, "aria-label": "Weight of the mode" });
  const said = element("output", {});
  const ofMode = element("label", { hidden: true }, amount, said);
  panel.append(element("div", { className: "choices" }, which,
    element("label", {}, withFilm, " turns as in the film"), element("label", {}, asSurface, " as a surface"), ofMode));

  const places = new Float32Array(3 * nPoints), placed = new Float32Array(3 * nPoints), solid = new Solid();
  const radius = nPoints > 5000 ? 1.6 : nPoints > 100 ? 3.2 : 4.5; // px of the page
  const isKnown = (i) => Number.isFinite(scales[i]);

  /** Points about the object's origin, in units of its size; false where the frame's are not known. */
  const shape = (i) => {
    const mode = which.value - 1; // 0: the mean
    if ((withFilm.checked || mode < 0) && !isKnown(i)) return false;
    const upright = [1, 0, 0, 0, 1, 0, 0, 0, 1];
    const [a, b, c, d, e, f, g, h, k] = withFilm.checked ? rotations.subarray(9 * i, 9 * i + 9) : upright;
    const grown = withFilm.checked ? scales[i] / size : 1;
    for (let v = 0; v < 3 * nPoints; v += 3) {
      let [x, y, z] = bases.subarray(v, v + 3);
      for (let m = 1; m < nBases; m++) {
        const weight = mode < 0 ? weights[nModes * i + m - 1] : m === mode ? Number(amount.value) : 0;
        if (!weight) continue;
        const at = 3 * nPoints * m + v;
        x += weight * bases[at];
        y += weight * bases[at + 1];
        z += weight * bases[at + 2];
      }
      places[v] = grown * (a * x + b * y + c * z);
      places[v + 1] = grown * (d * x + e * y + f * z);
      places[v + 2] = grown * (g * x + h * y + k * z);
    }
    return true;
  };

  const space = new Space(panel, {
    label: "The shape in space", reach,
    draw(space) {
      const { pen } = space;
      if (!shape(view.frame)) {
        pen.fillStyle = inkOf("--quiet");
        pen.fillText("This frame shows too few points for a pose.", 12, 20);
        return;
      }
      solid.begin(space);
      solid.placed(places, placed);
      if (asSurface.checked) solid.triangles(triangles, placed, BODY, null, null);
      solid.dots(placed, inks, radius, reach);
      solid.end();
      if (view.selected !== null) {
        pen.beginPath();
        pen.arc(placed[3 * view.selected] / space.fine, placed[3 * view.selected + 1] / space.fine, 6, 0, 2 * Math.PI);
        [pen.strokeStyle, pen.lineWidth] = [PICKED, 2.5];
        pen.stroke();
      }
      space.axes();
    },
    pick(x, y) {
      const k = solid.at(x, y);
      view.select(k < 0 || k >= nPoints ? null : k);
    },
  });
  const change = () => {
    ofMode.hidden = which.value < 2;
    said.textContent = ` ${Number(amount.value).toFixed(2)} s.d.`;
    space.redraw();
  };
  for (const input of [which, withFilm, asSurface]) input.addEventListener("change", change);
  amount.addEventListener("input", change);
  change();
});
