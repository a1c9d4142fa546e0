// Objects in front of the background: outlines, paths, uncertainty, boxes, identities.

const TAIL_SECONDS = 2;
const NINETY_PERCENT = 2.146; // standard deviations that hold 90 % of a Gaussian in the plane

addLayers((tracks) => {
  const { id: ids, box: boxes, seen, confidence, velocity, covariance, outline, corners, count, polygons, given, givenCount } = tracks;
  const starts = startsOf(count), shapes = startsOf(polygons), points = startsOf(corners);
  const colours = new Map(view.rows.map((row) => [row.id, row.colour]));
  const lives = new Map(view.rows.map((row) => [row.id, { frames: [], entries: [] }]));
  for (let i = 0; i < view.count; i++) {
    for (let k = starts[i]; k < starts[i + 1]; k++) {
      const life = lives.get(ids[k]);
      life.frames.push(i);
      life.entries.push(k);
    }
  }
  const boxOf = (k) => boxes.subarray(4 * k, 4 * k + 4);
  const footOf = (k) => [boxes[4 * k] + boxes[4 * k + 2] / 2, boxes[4 * k + 1] + boxes[4 * k + 3]];
  const middleOf = (k) => [boxes[4 * k] + boxes[4 * k + 2] / 2, boxes[4 * k + 1] + boxes[4 * k + 3] / 2];
  const speedOf = (k) => Math.hypot(velocity[2 * k], velocity[2 * k + 1]);
  /** The entry of an object in a frame, or -1. */
  const entryOf = (id, i) => {
    const life = lives.get(id);
    if (!life?.frames.length) return -1;
    const at = lastAtMost(life.frames, i);
    return life.frames[at] === i ? life.entries[at] : -1;
  };
  /** Every object of a frame, paler than the one that is selected. */
  const each = (pen, i, draw) => {
    for (let k = starts[i]; k < starts[i + 1]; k++) {
      const selected = ids[k] === view.selected;
      pen.globalAlpha = view.selected === null || selected ? 1 : 0.45;
      pen.strokeStyle = pen.fillStyle = colours.get(ids[k]);
      draw(k, selected);
    }
    pen.globalAlpha = 1;
  };

  addSwitch({
    name: "outlines", key: "o", draw(pen, i) {
      pen.beginPath();
      for (let shape = shapes[i]; shape < shapes[i + 1]; shape++) {
        for (let k = points[shape]; k < points[shape + 1]; k++) {
          pen[k === points[shape] ? "moveTo" : "lineTo"](outline[2 * k] + 0.5, outline[2 * k + 1] + 0.5);
        }
        pen.closePath();
      }
      pen.fillStyle = "rgb(255 60 50 / .18)";
      pen.fill("evenodd");
      pen.strokeStyle = "#ff4a3d";
      pen.lineWidth = 1.3 * pen.thin;
      pen.stroke();
    },
  });

  const drawPath = (pen, id, from, to, width) => {
    const { frames, entries } = lives.get(id);
    const first = frames.findIndex((frame) => frame >= from);
    if (first < 0) return;
    pen.beginPath();
    for (let at = first; at < frames.length && frames[at] <= to; at++) pen.lineTo(...footOf(entries[at]));
    pen.lineWidth = width * pen.thin;
    pen.stroke();
  };
  addSwitch({
    name: "paths", key: "p", draw(pen, i) {
      const from = lastAtMost(view.times, view.times[i] - TAIL_SECONDS);
      if (view.selected !== null && lives.has(view.selected)) {
        pen.strokeStyle = colours.get(view.selected);
        pen.globalAlpha = 0.6;
        pen.setLineDash([4 * pen.thin, 4 * pen.thin]);
        drawPath(pen, view.selected, 0, view.count, 1.5);
        pen.setLineDash([]);
      }
      each(pen, i, (k, selected) => drawPath(pen, ids[k], from, i, selected ? 4 : 2.5));
    },
  });

  if (given.length) {
    const detections = startsOf(givenCount);
    addSwitch({
      name: "detections", key: "g", draw(pen, i) {
        [pen.strokeStyle, pen.lineWidth] = ["#d0d0d0", 1.2 * pen.thin];
        for (let k = detections[i]; k < detections[i + 1]; k++) pen.strokeRect(...given.subarray(4 * k, 4 * k + 4));
      },
    });
  }

  addSwitch({
    name: "uncertainty", label: "uncertainty, 90 %", key: "u", draw(pen, i) {
      each(pen, i, (k) => {
        const [xx, xy, yy] = covariance.subarray(3 * k, 3 * k + 3);
        if (!(xx >= 0 && yy >= 0)) return;
        const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
        const [long, short] = [middle + apart, Math.max(0, middle - apart)].map((v) => NINETY_PERCENT * Math.sqrt(v));
        pen.beginPath();
        pen.ellipse(...middleOf(k), long, short, Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
        pen.lineWidth = 1.5 * pen.thin;
        pen.stroke();
        pen.globalAlpha *= 0.25;
        pen.fill();
      });
    },
  });

  addSwitch({
    name: "boxes", key: "b",
    draw(pen, i) {
      each(pen, i, (k, selected) => {
        pen.lineWidth = (selected ? 3.5 : 2) * pen.thin;
        pen.setLineDash(seen[k] ? [] : [5 * pen.thin, 4 * pen.thin]);
        pen.strokeRect(...boxOf(k));
      });
    },
    hit(x, y, i) {
      let best = null, least = Infinity;
      for (let k = starts[i]; k < starts[i + 1]; k++) {
        const [left, top, width, height] = boxOf(k);
        const inside = x >= left && x <= left + width && y >= top && y <= top + height;
        if (inside && width * height < least) { least = width * height; best = ids[k]; }
      }
      return best;
    },
    place(id, i) {
      const k = entryOf(id, i);
      return k < 0 ? null : boxOf(k);
    },
  });

  addSwitch({
    name: "identities", key: "i", draw(pen, i) {
      const taken = [];
      const size = 13 * pen.thin, margin = 3 * pen.thin, tall = size + 2 * margin;
      pen.font = `600 ${size}px system-ui, sans-serif`;
      pen.textBaseline = "middle";
      each(pen, i, (k) => {
        const [left, top, width, height] = boxOf(k), text = String(ids[k]);
        const wide = pen.measureText(text).width + 2 * margin;
        const corners = [[left, top - tall], [left + width - wide, top - tall], [left, top], [left, top + height]];
        const free = corners
          .map(([x, y]) => [clamped(x, 0, view.size[0] - wide), clamped(y, 0, view.size[1] - tall), wide, tall])
          .find((place) => !taken.some((other) => overlap(place, other)));
        if (!free) return;
        taken.push(free);
        pen.fillRect(...free);
        pen.fillStyle = inkOn(pen.fillStyle);
        pen.fillText(text, free[0] + margin, free[1] + tall / 2);
      });
    },
  });

  addDetails((id, i) => {
    const k = entryOf(id, i), { frames } = lives.get(id) ?? { frames: [] };
    const always = [["frames", String(frames.length)]];
    if (k < 0) return [...always, ["now", "not there"]];
    const [, , width, height] = boxOf(k), [x, y] = footOf(k);
    return [
      ...always,
      ["now", seen[k] ? "seen" : "predicted"],
      ["feet", `${x.toFixed(0)}, ${y.toFixed(0)} px`],
      ["size", `${width.toFixed(0)} × ${height.toFixed(0)} px`],
      ["speed", known(speedOf(k), "px/s")],
      ["± along x, y", [0, 2].map((n) => known(Math.sqrt(covariance[3 * k + n]), "px")).join(", ")],
      ["confidence", `${(100 * confidence[k]).toFixed(0)} %`],
    ];
  });

  addPlot({
    name: "speed", unit: "px/s", values(id) {
      const life = lives.get(id);
      if (!life) return null;
      const values = new Float32Array(view.count).fill(NaN);
      life.frames.forEach((frame, at) => { values[frame] = speedOf(life.entries[at]); });
      return values;
    },
  });
});

/** A value, or that it is not known. */
function known(value, unit) {
  return Number.isFinite(value) ? `${short(value)} ${unit}` : "–";
}

function overlap([x, y, wide, tall], [left, top, width, height]) {
  return x < left + width && left < x + wide && y < top + height && top < y + tall;
}

/** Black or white, whichever is read on a colour #rrggbb. */
function inkOn(colour) {
  const [red, green, blue] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
  return 0.299 * red + 0.587 * green + 0.114 * blue > 130 ? "#000" : "#fff";
}
