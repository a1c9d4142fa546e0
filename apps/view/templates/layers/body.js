// A body: its skeleton over the film and in space, with how sure each joint is.

addLayers(({ joints, samples, second, secondWeight, worthSaying, perPx, bones, colours, parts, seen, arm, centre, reach }) => {
  const n = colours.length, perFrame = samples.length / 3 / view.count;
  const PATH_SECONDS = 1.5; // to both sides
  const NEAR = 15; // px of the screen: a click selects the joint that is not farther away
  const joint = (i, j) => joints.subarray(9 * (n * i + j), 9 * (n * i + j + 1));
  const isSeen = (i, j) => parts.includes(j) && seen[parts.length * i + parts.indexOf(j)] === 1;
  /** Of what is near paler, of what is far darker. */
  const shade = (colour, depth) =>
    mixed(colour, depth < 0 ? "#ffffff" : "#000000", 0.45 * Math.min(1, Math.abs(depth) / arm));
  let thin = 1;

  /** Draw a skeleton, far bones first; `at(j)` is a joint's x, y and depth. */
  const skeleton = (pen, at, unit) => {
    const lines = bones.map(([a, b, colour]) => ({ a: at(a), b: at(b), colour }));
    lines.sort((one, other) => other.a[2] + other.b[2] - one.a[2] - one.b[2]);
    pen.lineCap = "round";
    for (const { a, b, colour } of lines) {
      const depth = (a[2] + b[2]) / 2, width = (4 - 1.5 * clamped(depth / arm, -1, 1)) * unit;
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      for (const [ink, line] of [["rgb(0 0 0 / .55)", width + 2 * unit], [shade(colour, depth), width]]) {
        [pen.strokeStyle, pen.lineWidth] = [ink, line];
        pen.stroke();
      }
    }
  };

  const knobs = (pen, i, at, unit) => {
    for (let j = 0; j < n; j++) {
      const [x, y] = at(j), selected = j === view.selected;
      pen.beginPath();
      pen.arc(x, y, (selected ? 6.5 : parts.includes(j) ? 4.5 : 3) * unit, 0, 2 * Math.PI);
      pen.fillStyle = isSeen(i, j) || !parts.includes(j) ? colours[j] : "#ffffff"; // hidden: a ring
      pen.strokeStyle = selected ? "#ffffff" : isSeen(i, j) || !parts.includes(j) ? "#000000" : colours[j];
      pen.lineWidth = (selected ? 2.5 : 1.5) * unit;
      pen.fill();
      pen.stroke();
    }
  };

  /** Poses of the posterior, thin; `place(x, y, z)` gives where to draw. */
  const poses = (pen, i, place, unit) => {
    pen.lineWidth = unit;
    pen.globalAlpha = 0.4;
    for (const [a, b, colour] of bones) {
      pen.strokeStyle = colour;
      pen.beginPath();
      for (let k = 0; k < perFrame; k += n) {
        for (const [which, to] of [[a, "moveTo"], [b, "lineTo"]]) {
          const from = 3 * (perFrame * i + k + which);
          const [x, y] = place(samples[from] / perPx, samples[from + 1] / perPx, samples[from + 2] / perPx);
          pen[to](x, y);
        }
      }
      pen.stroke();
    }
    pen.globalAlpha = 1;
  };

  const isDoubtful = (i) => secondWeight[i] >= worthSaying;
  /** Arms of the second best answer, dashed and paler; `place(x, y, z)` gives where to draw. */
  const otherArms = (pen, i, place, unit) => {
    if (!isDoubtful(i)) return;
    const at = (j) => place(...[0, 1, 2].map((axis) => second[3 * (n * i + j) + axis] / perPx));
    for (const [a, b, colour] of bones) {
      if (colour === colours[0]) continue; // not of the trunk
      pen.beginPath();
      pen.moveTo(...at(a).slice(0, 2));
      pen.lineTo(...at(b).slice(0, 2));
      for (const [ink, width] of [["rgb(0 0 0 / .55)", 4], [mixed(colour, "#ffffff", 0.5), 2]]) {
        [pen.strokeStyle, pen.lineWidth] = [ink, width * unit];
        pen.setLineDash([6 * unit, 6 * unit]);
        pen.stroke();
      }
    }
    pen.setLineDash([]);
  };

  const onFilm = (i) => (j) => [joint(i, j)[0] + 0.5, joint(i, j)[1] + 0.5, joint(i, j)[2]];

  /** Where the selected joint is a little before and after; `place(joint)` gives where to draw. */
  const path = (pen, i, place, width) => {
    if (view.selected === null) return;
    pen.beginPath();
    for (let k = 0; k < view.count; k++) {
      if (Math.abs(view.times[k] - view.times[i]) > PATH_SECONDS) continue;
      const [x, y] = place(joint(k, view.selected));
      pen.lineTo(x, y);
    }
    [pen.strokeStyle, pen.lineWidth] = [colours[view.selected], width];
    pen.stroke();
  };
  addSwitch({
    name: "path", label: "path of the selected joint", key: "p",
    draw: (pen, i) => path(pen, i, ([x, y]) => [x + 0.5, y + 0.5], 2 * pen.thin),
  });
  addSwitch({
    name: "poses", label: "poses drawn from the posterior", key: "d", on: false,
    draw: (pen, i) => poses(pen, i, (x, y) => [x + 0.5, y + 0.5], pen.thin),
  });
  addSwitch({
    name: "regions", label: "90 % regions of joints", key: "u", draw(pen, i) {
      for (let j = 0; j < n; j++) {
        const [x, y, , xx, xy, , yy] = joint(i, j);
        region(pen, x + 0.5, y + 0.5, xx, xy, yy, REGION_OF_2);
        pen.fillStyle = colours[j] + (isSeen(i, j) ? "30" : "14");
        pen.fill();
        [pen.strokeStyle, pen.lineWidth] = [colours[j], 1.5 * pen.thin];
        pen.setLineDash(isSeen(i, j) ? [] : [4 * pen.thin, 3 * pen.thin]);
        pen.stroke();
      }
      pen.setLineDash([]);
    },
  });
  addSwitch({
    name: "second", label: `second answer, from ${100 * worthSaying} % on`, key: "a",
    draw: (pen, i) => otherArms(pen, i, (x, y) => [x + 0.5, y + 0.5], pen.thin),
  });
  addSwitch({
    name: "skeleton", key: "s",
    draw(pen, i) {
      thin = pen.thin;
      skeleton(pen, onFilm(i), thin);
      knobs(pen, i, onFilm(i), thin);
    },
    hit: (x, y, i) => nearest(onFilm(i), x, y, NEAR * thin),
    place(j, i) {
      const [x, y] = onFilm(i)(j);
      return [x - arm / 4, y - arm / 4, arm / 2, arm / 2];
    },
  });

  const nearest = (at, x, y, within) => {
    let best = null, least = within;
    for (let j = 0; j < n; j++) {
      const [column, row] = at(j), distance = Math.hypot(column - x, row - y);
      if (distance < least) [best, least] = [j, distance];
    }
    return best;
  };

  let where = null; // of the joints in the view that turns
  const space = new Space(addPanel("In space"), {
    label: "The body in space",
    centre, reach,
    draw(space) {
      const i = view.frame, { pen } = space;
      where = (j) => space.place(...joint(i, j).subarray(0, 3));
      poses(pen, i, (...place) => space.place(...place), 1);
      for (const j of new Set([...parts, view.selected])) {
        if (j === null) continue;
        const [x, y] = where(j);
        region(pen, x, y, ...space.spread(joint(i, j).subarray(3)), REGION_OF_3);
        pen.fillStyle = colours[j] + "30";
        pen.fill();
      }
      path(pen, i, ([x, y, z]) => space.place(x, y, z), 1.5);
      otherArms(pen, i, (...place) => space.place(...place), 1);
      skeleton(pen, where, 1);
      knobs(pen, i, where, 1);
      space.axes();
    },
    pick: (x, y) => view.select(nearest(where, x, y, NEAR)),
  });

  const elsewhere = (j, i) => {
    const [x, y] = [0, 1].map((axis) => second[3 * (n * i + j) + axis] / perPx);
    return `${x.toFixed(1)}, ${y.toFixed(1)} px (${(100 * secondWeight[i]).toFixed(0)} %)`;
  };
  const speed = (j, i) => {
    const [a, b] = [Math.max(i - 1, 0), Math.min(i + 1, view.count - 1)], [p, q] = [joint(a, j), joint(b, j)];
    return a === b ? NaN : Math.hypot(q[0] - p[0], q[1] - p[1]) / (view.times[b] - view.times[a]);
  };
  addDetails((j, i) => {
    const [x, y, z, xx, , , yy, , zz] = joint(i, j);
    const px = (value) => `${value.toFixed(1)} px`;
    return [
      ["now", isSeen(i, j) ? "seen" : parts.includes(j) ? "hidden, predicted" : "inferred"],
      ["place", `${x.toFixed(1)}, ${y.toFixed(1)} px`],
      ...(isDoubtful(i) && colours[j] !== colours[0] ? [["or", elsewhere(j, i)]] : []),
      ["unsure by", `${Math.sqrt(xx).toFixed(1)}, ${Math.sqrt(yy).toFixed(1)} px`],
      ["depth", z < 0 ? `${px(-z)} nearer than the neck` : `${px(z)} farther than the neck`],
      ["depth unsure by", px(Math.sqrt(zz))],
      ...(view.count > 1 ? [["speed", `${speed(j, i).toFixed(0)} px/s`]] : []),
    ];
  });
  const over = (value) => (j) => Float32Array.from({ length: view.count }, (_, i) => value(j, i));
  addPlot({ name: "selected: speed", unit: "px/s", values: over(speed) });
  addPlot({ name: "selected: depth", unit: "px", values: over((j, i) => joint(i, j)[2]) });
});
