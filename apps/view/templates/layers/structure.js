// A reconstruction: points over the film and in space, from where the camera saw them, how sure they are.

addLayers((structure) => {
  const { corner, tracked, inks, positions, residuals, spreads, counts, frames } = structure;
  const { geometry, reason, space: inSpace } = structure;
  const n = tracked.length, order = new Map([...tracked].map((id, k) => [id, k]));
  const NEAR = 10; // px of the screen: a click selects the point that is not farther away
  const TRAIL = 12, LONGER = 10;
  const PICKED = "#ff3b30";
  const MOST_REGIONS = 300;
  let thin = 1;

  const isSeen = (i, k) => !Number.isNaN(residuals[2 * (n * i + k)]);
  /** Where a point is on the film: as observed, or else by shape and camera. */
  const fitted = (i, k) => [positions[2 * (n * i + k)] - corner[0], positions[2 * (n * i + k) + 1] - corner[1]];
  const residual = (i, k) => isSeen(i, k) ? residuals.subarray(2 * (n * i + k), 2 * (n * i + k) + 2) : [0, 0];
  const place = (i, k) => {
    const [[x, y], [dx, dy]] = [fitted(i, k), residual(i, k)];
    return [x + dx, y + dy];
  };
  const spread = (i, k) => spreads.subarray(3 * (n * i + k), 3 * (n * i + k + 1));
  /** Those over the film, the selected one last. */
  const each = (draw) => {
    const last = order.get(view.selected);
    for (let k = 0; k < n; k++) if (k !== last) draw(k, false);
    if (last !== undefined) draw(last, true);
  };

  addSwitch({
    name: "trails", key: "t", draw(pen, i) {
      pen.globalAlpha = 0.7;
      each((k, selected) => {
        if (!isSeen(i, k)) return;
        pen.beginPath();
        const first = selected ? 0 : Math.max(0, i - TRAIL);
        for (let j = first; j <= i; j++) if (isSeen(j, k)) pen.lineTo(...place(j, k));
        [pen.strokeStyle, pen.lineWidth] = [inks[k], (selected ? 2.5 : 1) * pen.thin];
        pen.stroke();
      });
    },
  });
  addSwitch({
    name: "regions", label: "90 % regions of points", key: "u", on: false, draw(pen, i) {
      each((k) => {
        if (!Number.isFinite(fitted(i, k)[0])) return;
        region(pen, ...fitted(i, k), ...spread(i, k), REGION_OF_2);
        [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [inks[k] + "40", inks[k], pen.thin];
        pen.fill();
        pen.stroke();
      });
    },
  });
  addSwitch({
    name: "residuals", label: `residuals, ${LONGER} times as long`, key: "r", on: false, draw(pen, i) {
      each((k) => {
        const [[x, y], [dx, dy]] = [fitted(i, k), residual(i, k)];
        for (const [ink, width] of [["#000000", 3], [inks[k], 1.5]]) {
          pen.beginPath();
          pen.moveTo(x, y);
          pen.lineTo(x + LONGER * dx, y + LONGER * dy);
          [pen.strokeStyle, pen.lineWidth] = [ink, width * pen.thin];
          pen.stroke();
        }
      });
    },
  });
  addSwitch({
    name: "points", label: "points (rings: not seen)", key: "d",
    draw(pen, i) {
      thin = pen.thin;
      each((k, selected) => {
        const [x, y] = place(i, k);
        if (!Number.isFinite(x)) return;
        pen.beginPath();
        pen.arc(x, y, (selected ? 6 : 3) * thin, 0, 2 * Math.PI);
        if (isSeen(i, k)) {
          [pen.strokeStyle, pen.lineWidth, pen.fillStyle] = ["#000000", 1.5 * thin, selected ? PICKED : inks[k]];
          pen.stroke();
          pen.fill();
        } else {
          [pen.strokeStyle, pen.lineWidth] = [selected ? PICKED : inks[k], (selected ? 2.5 : 1.2) * thin];
          pen.stroke();
        }
      });
    },
    hit(x, y, i) {
      let best = null, least = NEAR * thin;
      for (let k = 0; k < n; k++) {
        const [column, row] = place(i, k), distance = Math.hypot(column - x, row - y);
        if (distance < least) [best, least] = [tracked[k], distance];
      }
      return best;
    },
    place(id, i) {
      const k = order.get(id), [x, y] = k === undefined ? [NaN] : place(i, k), side = view.size[0] / 6;
      return Number.isFinite(x) ? [x - side / 2, y - side / 2, side, side] : null;
    },
  });

  const panel = addPanel("In space");
  const say = (textContent) => panel.append(element("p", { className: "quiet hint", textContent }));
  if (inSpace === null) say(`The shape is undetermined: ${reason}.`); else addSpace(panel, inSpace);
  if (geometry === "affine") say(`Up to an affine map, since ${reason}: lengths and angles mean nothing.`);
  const inAll = [["Over the film", n], ["in space", inSpace?.points.length ?? counts.length]];
  const few = inAll.filter(([, some]) => some < counts.length);
  if (few.length) {
    const words = few.map(([where, some]) => `${where}: ${some} of ${counts.length} points`);
    say(`${words.join(", ")}, evenly chosen.`);
  }

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
    panel.append(choices);
    const rotation = (i) => rotations.subarray(9 * i, 9 * i + 9);
    /** From where a camera looks, out of the points' middle: against its third axis. */
    const stand = (i, far) => [0, 1, 2].map((k) => centre[k] - far * reach * rotation(i)[6 + k]);

    const seenByCamera = (i) => {
      const [a, b, c, d, e, f, g, h, k] = rotation(i), [x0, y0, z0] = centre;
      for (let v = 0; v < places.length; v += 3) {
        const x = places[v] - x0, y = places[v + 1] - y0, z = places[v + 2] - z0;
        turned[v] = a * x + b * y + c * z + x0;
        turned[v + 1] = d * x + e * y + f * z + y0;
        turned[v + 2] = g * x + h * y + k * z + z0;
      }
      return turned;
    };

    const space = new Space(panel, {
      label: "The points in space", centre, reach: 1.25 * reach,
      draw(space) {
        const i = view.frame, byCamera = withCamera.checked && Number.isFinite(rotation(i)[0]);
        const now = byCamera ? seenByCamera(i) : places;
        solid.begin(space);
        solid.placed(now, placed);
        solid.dots(placed, asPicture.checked ? colours : inks, radius, reach);
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
        view.select(k < 0 ? null : points[k]);
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

  const life = (k) => {
    const spans = [];
    for (let i = 0; i < view.count; i++) {
      const kind = isSeen(i, k) ? 0 : 1;
      if (i && spans[spans.length - 1] === kind) spans[spans.length - 2] = i; else spans.push(i, i, kind);
    }
    return spans;
  };
  addRows((id) => {
    const k = order.get(id);
    const [colour, spans] = k === undefined ? ["#888888", [0, view.count - 1, 1]] : [inks[k], life(k)];
    return { id, label: `point ${id}`, colour, spans };
  });
  addDetails((id, i) => {
    const k = order.get(id), seen = [["seen in", `${counts[id]} of ${frames} frames`]];
    if (k === undefined) return [...seen, ["over the film", "not on this page: too many points"]];
    const [x, y] = place(i, k), [xx, , yy] = spread(i, k);
    const now = [["now", isSeen(i, k) ? "seen" : "not seen, by shape and camera"]];
    if (Number.isFinite(x)) {
      now.push(["place", `${(x + corner[0]).toFixed(1)}, ${(y + corner[1]).toFixed(1)} px`]);
      now.push(["unsure by", `${Math.sqrt(xx).toFixed(2)}, ${Math.sqrt(yy).toFixed(2)} px`]);
    }
    if (isSeen(i, k)) now.push(["residual", `${Math.hypot(...residual(i, k)).toFixed(2)} px`]);
    return [...seen, ...now];
  });
  const curve = (value, k) => Float32Array.from({ length: view.count }, (_, i) => value(i, k));
  const over = (value) => (id) => order.has(id) ? curve(value, order.get(id)) : null;
  const missed = (i, k) => isSeen(i, k) ? Math.hypot(...residual(i, k)) : NaN;
  addPlot({ name: "selected: residual", unit: "px", values: over(missed) });
  addPlot({ name: "selected ±", unit: "px", values: over((i, k) => Math.sqrt(spread(i, k)[0] + spread(i, k)[2])) });
});
