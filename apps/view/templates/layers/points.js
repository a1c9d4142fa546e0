// Points over the film: where they are seen, where they should be, how sure that is.

addLayers(({ corner, tracked, inks, positions, residuals, spreads, counts, frames, by }) => {
  const n = tracked.length, order = new Map([...tracked].map((id, k) => [id, k]));
  const NEAR = 10; // px of the screen: a click selects the point that is not farther away
  const TRAIL = 12, LONGER = 10;
  let thin = 1;

  const isSeen = (i, k) => !Number.isNaN(residuals[2 * (n * i + k)]);
  /** Where a point is on the film: as observed, or else where it should be. */
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

  if (n < counts.length) {
    const few = `Over the video: ${n} of ${counts.length} points, evenly chosen.`;
    byId("switches").append(element("p", { className: "quiet hint", textContent: few }));
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
    return { id, label: `point ${id + 1}`, colour, spans };
  });
  addDetails((id, i) => {
    const k = order.get(id), seen = [["seen in", `${counts[id]} of ${frames} frames`]];
    if (k === undefined) return [...seen, ["over the film", "not on this page: too many points"]];
    const [x, y] = place(i, k), [xx, , yy] = spread(i, k);
    const now = [["now", isSeen(i, k) ? "seen" : `not seen, by ${by}`]];
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
