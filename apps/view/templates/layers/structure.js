// A reconstruction in space: points, from where the camera saw them, how sure they are.

addLayers(({ geometry, reason, count, space: inSpace, surface }) => {
  const MOST_REGIONS = 300, SURFACE = 0xb0b0b0;

  const panel = addPanel("In space");
  const say = (textContent) => panel.append(element("p", { className: "quiet hint", textContent }));
  if (inSpace === null) say(`The shape is undetermined: ${reason}.`); else addSpace(panel, inSpace);
  if (geometry === "affine") say(`Up to an affine map, since ${reason}: lengths and angles are not determined.`);
  const some = inSpace?.points.length ?? count;
  if (some < count) say(`In space: ${some} of ${count} points, evenly chosen.`);

  function addSpace(panel, { points, places, inks, colours, covariances, rotations, centre, reach }) {
    const shownAt = new Map([...points].map((id, k) => [id, k]));
    const solid = new Solid(), placed = new Float32Array(places.length), turned = new Float32Array(places.length);
    const radius = points.length > 5000 ? 1.6 : points.length > 100 ? 3.2 : 4.5; // px of the page
    const withCamera = element("input", { type: "checkbox" }), asPicture = element("input", { type: "checkbox" });
    const canTurn = rotations.some(Number.isFinite);
    const choices = element("div", { className: "choices" });
    if (canTurn) choices.append(element("label", {}, withCamera, " as the frame's camera sees it"));
    const around = element("input", { type: "checkbox" });
    choices.append(element("label", {}, around, " 90 % regions"));
    if (colours) choices.append(element("label", {}, asPicture, " in the film's colours"));
    const asSurface = element("input", { type: "checkbox" });
    const corners = surface && { turned: new Float32Array(surface.corners.length), placed: new Float32Array(surface.corners.length) };
    let texture = null; // the picture that the surface carries, when it is there
    if (surface) {
      choices.append(element("label", {}, asSurface, ` as a surface, with the picture of frame ${surface.frame}`));
      pixelsOf(surface.picture).then((picture) => { texture = picture; space.redraw(); });
    }
    panel.append(choices);
    const rotation = (i) => rotations.subarray(9 * i, 9 * i + 9);
    /** From where a camera looks, out of the points' middle: against its third axis. */
    const stand = (i, far) => [0, 1, 2].map((k) => centre[k] - far * reach * rotation(i)[6 + k]);

    /** Places about the points' middle, turned as a camera sees them. */
    const seenByCamera = (i, from, into) => {
      const [a, b, c, d, e, f, g, h, k] = rotation(i), [x0, y0, z0] = centre;
      for (let v = 0; v < from.length; v += 3) {
        const x = from[v] - x0, y = from[v + 1] - y0, z = from[v + 2] - z0;
        into[v] = a * x + b * y + c * z + x0;
        into[v + 1] = d * x + e * y + f * z + y0;
        into[v + 2] = g * x + h * y + k * z + z0;
      }
      return into;
    };

    const space = new Space(panel, {
      label: "The points in space", centre, reach: 1.25 * reach,
      draw(space) {
        const i = view.frame, byCamera = withCamera.checked && Number.isFinite(rotation(i)[0]);
        const now = byCamera ? seenByCamera(i, places, turned) : places;
        solid.begin(space);
        solid.placed(now, placed);
        if (asSurface.checked) {
          const at = byCamera ? seenByCamera(i, surface.corners, corners.turned) : surface.corners;
          solid.triangles(surface.triangles, solid.placed(at, corners.placed), SURFACE, texture, surface.onPicture);
        } else {
          solid.dots(placed, asPicture.checked ? colours : inks, radius, reach);
        }
        solid.end();
        if (canTurn && !byCamera) cameras(space, i);
        const k = shownAt.get(view.selected);
        if (around.checked) for (const j of nearTo(k)) surround(space, j, byCamera && rotation(i));
        if (k !== undefined) {
          const [x, y] = space.place(...now.subarray(3 * k, 3 * k + 3));
          if (!around.checked) surround(space, k, byCamera && rotation(i));
          space.pen.beginPath();
          space.pen.arc(x, y, 6, 0, 2 * Math.PI);
          [space.pen.strokeStyle, space.pen.lineWidth] = [PICKED, 2.5];
          space.pen.stroke();
        }
        if (!byCamera) space.axes();
      },
      pick(x, y) {
        const k = solid.at(x, y);
        view.select(k < 0 ? null : asSurface.checked ? surface.points[k] : points[k]);
      },
    });
    choices.addEventListener("change", () => space.redraw());

    /** The region of a point; `turn`, if any, is by how the points are turned. */
    function surround(space, k, turn) {
      const [x, y] = [placed[3 * k] / space.fine, placed[3 * k + 1] / space.fine];
      let covariance = covariances.subarray(6 * k, 6 * k + 6);
      if (turn) covariance = turnedCovariance(turn, covariance);
      region(space.pen, x, y, ...space.spread(covariance), REGION_OF_3);
      const ink = inks[k], colour = `rgb(${ink & 255} ${(ink >> 8) & 255} ${ink >> 16}`;
      [space.pen.fillStyle, space.pen.strokeStyle, space.pen.lineWidth] = [`${colour} / .25)`, `${colour})`, 1];
      space.pen.fill();
      space.pen.stroke();
    }

    /** The points nearest to one; all where they are few, or those nearest to their middle. */
    function nearTo(k) {
      const all = Array.from(points, (_, j) => j);
      if (all.length <= MOST_REGIONS) return all;
      const [x, y, z] = k === undefined ? centre : places.subarray(3 * k, 3 * k + 3);
      const far = Float32Array.from(all, (j) => Math.hypot(places[3 * j] - x, places[3 * j + 1] - y, places[3 * j + 2] - z));
      const limit = far.slice().sort()[MOST_REGIONS - 1];
      return all.filter((j) => far[j] <= limit);
    }

    /** The way of the camera about the points, and where it is now, with the picture's axes. */
    function cameras(space, i) {
      const { pen } = space, far = 1.15;
      pen.beginPath();
      for (let j = 0; j < view.count; j++) {
        if (!Number.isFinite(rotation(j)[0])) continue;
        const [x, y] = space.place(...stand(j, far));
        pen.lineTo(x, y);
      }
      [pen.strokeStyle, pen.lineWidth] = [inkOf("--quiet"), 1];
      pen.stroke();
      if (!Number.isFinite(rotation(i)[0])) return;
      const at = stand(i, far), [x, y] = space.place(...at);
      for (const [axis, ink] of [[0, "#e5484d"], [1, "#30a46c"], [2, "#3e63dd"]]) {
        const end = at.map((value, k) => value + 0.2 * reach * rotation(i)[3 * axis + k]), [u, v] = space.place(...end);
        pen.beginPath();
        pen.moveTo(x, y);
        pen.lineTo(u, v);
        [pen.strokeStyle, pen.lineWidth] = [ink, 2];
        pen.stroke();
      }
    }
  }
});
