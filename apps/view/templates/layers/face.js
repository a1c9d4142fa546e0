// A face: the mesh over the film, the head in space with its texture, how sure its points are.

addLayers((face) => {
  const { points, pose, landmarks, states, angles, angleNames, errors, shown, mesh, ink } = face;
  const { bases, triangles, onTexture, textures } = face;
  const n = shown.length, [nBases, nVertices] = bases.shape;
  const NEAR = 12; // px of the screen: a click selects the point that is not farther away
  const SKIN = 0x96afd7, UNKNOWN = 0x707070;
  const HOT = [[50, 25, 120], [130, 35, 125], [205, 65, 85], [245, 130, 35], [250, 235, 120]];
  const perPose = pose.length / view.count, perLandmarks = landmarks.length / 2 / view.count;
  const point = (i, k) => points.subarray(5 * (n * i + k), 5 * (n * i + k + 1));
  const isLost = (i) => states[3 * i] === 1, isMissing = (i) => states[3 * i + 1] === 1;
  const sides = facing(0); // of the triangles in the first frame
  let thin = 1;

  /** Twice the signed area of every triangle over the film. */
  function facing(i) {
    return Float32Array.from({ length: mesh.length / 3 }, (_, t) => {
      const [[ax, ay], [bx, by], [cx, cy]] = [0, 1, 2].map((k) => point(i, mesh[3 * t + k]));
      return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    });
  }

  addSwitch({
    name: "mesh", key: "m", draw(pen, i) {
      const now = facing(i);
      pen.beginPath();
      for (let t = 0; t < mesh.length / 3; t++) {
        if (now[t] * sides[t] < 0) continue; // turned away
        for (const k of [0, 1, 2]) {
          const [x, y] = point(i, mesh[3 * t + k]);
          pen[k ? "lineTo" : "moveTo"](x + 0.5, y + 0.5);
        }
        pen.closePath();
      }
      pen.globalAlpha = isLost(i) || isMissing(i) ? 0.3 : 0.75;
      for (const [colour, width] of [["#000000", 2], [ink, 1]]) {
        [pen.strokeStyle, pen.lineWidth] = [colour, width * pen.thin];
        pen.stroke();
        pen.globalAlpha = Math.min(1, pen.globalAlpha + 0.1);
      }
    },
  });
  if (perLandmarks) {
    addSwitch({
      name: "landmarks", label: "landmarks, carried along", key: "l", on: false, draw(pen, i) {
        for (let k = perLandmarks * i; k < perLandmarks * (i + 1); k++) {
          dot(pen, landmarks[2 * k], landmarks[2 * k + 1], 2.5, "#00c8ff");
        }
      },
    });
  }
  addSwitch({
    name: "regions", label: "90 % regions of points", key: "u", draw(pen, i) {
      pen.beginPath();
      for (let k = 0; k < n; k++) {
        const [x, y, xx, xy, yy] = point(i, k);
        region(pen, x + 0.5, y + 0.5, xx, xy, yy, REGION_OF_2);
        pen.fillStyle = ink + "28";
        pen.fill();
        [pen.strokeStyle, pen.lineWidth] = [ink, pen.thin];
        pen.stroke();
      }
    },
  });
  addSwitch({
    name: "points", key: "d",
    draw(pen, i) {
      thin = pen.thin;
      for (let k = 0; k < n; k++) {
        if (view.selected === k + 1) continue;
        const [x, y] = point(i, k);
        dot(pen, x, y, 1.8, ink);
      }
      if (view.selected > 0) dot(pen, ...point(i, view.selected - 1).subarray(0, 2), 5.5, "#ff3b30");
    },
    hit(x, y, i) {
      const k = nearest((k) => point(i, k), x - 0.5, y - 0.5, NEAR * thin);
      return k === null ? null : k + 1;
    },
    place(id, i) {
      const all = id > 0 ? [point(i, id - 1)] : Array.from({ length: n }, (_, k) => point(i, k));
      const [xs, ys] = [0, 1].map((axis) => all.map((one) => one[axis]));
      const [left, top, size] = [Math.min(...xs), Math.min(...ys), id > 0 ? pose[perPose * i + 11] : 0];
      return [left - size / 2, top - size / 2, Math.max(...xs) - left + size, Math.max(...ys) - top + size];
    },
  });

  function dot(pen, x, y, radius, colour) {
    if (!Number.isFinite(x)) return;
    pen.beginPath();
    pen.arc(x + 0.5, y + 0.5, radius * pen.thin, 0, 2 * Math.PI);
    [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [colour, "rgb(0 0 0 / .8)", pen.thin];
    pen.stroke();
    pen.fill();
  }

  function nearest(at, x, y, within) {
    let best = null, least = within;
    for (let k = 0; k < n; k++) {
      const [column, row] = at(k), distance = Math.hypot(column - x, row - y);
      if (distance < least) [best, least] = [k, distance];
    }
    return best;
  }

  // --- the head in space ---

  const panel = addPanel("Head");
  const paints = ["texture", "its variance", "shape"].map((name, k) => new Option(name, k));
  const look = element("select", { "aria-label": "How the head is painted" }, ...paints);
  const withFilm = element("input", { type: "checkbox", checked: true });
  panel.append(element("div", { className: "choices" }, look, element("label", {}, withFilm, " turns as in the film")));
  const solid = new Solid(), vertices = new Float32Array(3 * nVertices), placed = new Float32Array(3 * nVertices);
  const painted = []; // texture and variance, when they are there

  /** The vertices in frame i, px about the head's origin: in its pose, or as seen from the front. */
  const head = (i, turned) => {
    const from = perPose * i, upright = [1, 0, 0, 0, 1, 0, 0, 0, 1];
    const [a, b, c, d, e, f, g, h, k] = turned ? pose.subarray(from, from + 9) : upright;
    const size = pose[from + 11];
    for (let v = 0; v < 3 * nVertices; v += 3) {
      let x = 0, y = 0, z = 0;
      for (let m = 0; m < nBases; m++) {
        const weight = pose[from + 11 + m] / size, base = 3 * nVertices * m + v;
        x += weight * bases[base];
        y += weight * bases[base + 1];
        z += weight * bases[base + 2];
      }
      vertices[v] = a * x + b * y + c * z;
      vertices[v + 1] = d * x + e * y + f * z;
      vertices[v + 2] = g * x + h * y + k * z;
    }
  };

  const ends = (axis) => {
    const values = bases.subarray(0, 3 * nVertices).filter((_, k) => k % 3 === axis);
    return values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  };
  const spans = [0, 1, 2].map(ends);
  const space = new Space(panel, {
    label: "The head in space", centre: spans.map(([low, high]) => (low + high) / 2),
    reach: 0.62 * Math.max(...spans.map(([low, high]) => high - low)),
    draw(space) {
      head(view.frame, withFilm.checked);
      solid.begin(space);
      solid.placed(vertices, placed);
      solid.triangles(triangles, placed, look.value === "2" ? SKIN : UNKNOWN, painted[look.value] ?? null, onTexture);
      solid.end();
      if (view.selected > 0) {
        space.pen.thin = 1;
        const [x, y] = where(view.selected - 1);
        dot(space.pen, x - 0.5, y - 0.5, 5, "#ff3b30");
      }
    },
    pick(x, y) {
      const k = nearest(where, x, y, 2 * NEAR);
      view.select(k === null ? null : k + 1);
    },
  });
  const where = (k) => [placed[3 * shown[k]] / space.fine, placed[3 * shown[k] + 1] / space.fine];
  for (const input of [look, withFilm]) input.addEventListener("change", () => space.redraw());

  // --- its texture, as it was at the end ---

  const pictures = addPanel("Texture at the end");
  const images = textures.map(({ caption, png }) => {
    const picture = element("img", { src: `data:image/png;base64,${png}`, alt: `Texture: ${caption}` });
    const below = element("figcaption", { className: "quiet", textContent: caption });
    pictures.append(element("figure", { className: "texture" }, picture, below));
    return picture;
  });
  Promise.all(images.map((image) => image.decode())).then(() => {
    const [mean, variance] = images.map(greysOf), width = images[0].naturalWidth;
    // both are black where nothing is known, and the variance also where it is least
    painted[0] = { width, pixels: mean.map((value) => value && grey(value)) };
    painted[1] = { width, pixels: variance.map((value, at) => mean[at] && heat(value)) };
    space.redraw();
  });

  function greysOf(image) {
    const sheet = element("canvas", { width: image.naturalWidth, height: image.naturalHeight });
    const pen = sheet.getContext("2d");
    pen.drawImage(image, 0, 0);
    const { data } = pen.getImageData(0, 0, sheet.width, sheet.height);
    return Int32Array.from({ length: data.length / 4 }, (_, at) => data[4 * at]);
  }

  function grey(value) {
    return 0xff000000 | (value << 16) | (value << 8) | value;
  }

  function heat(value) {
    const at = value / 255 * (HOT.length - 1), k = Math.min(Math.floor(at), HOT.length - 2);
    const [red, green, blue] = HOT[k].map((low, channel) => Math.round(low + (at - k) * (HOT[k + 1][channel] - low)));
    return 0xff000000 | (blue << 16) | (green << 8) | red;
  }

  // --- what is selected ---

  addRows((id) => id > 0 && id <= n
    ? { id, label: `point ${shown[id - 1] + 1}`, colour: "#ff3b30", spans: rowOf(0).spans } : null);
  const unsure = (k) => (i) => Math.sqrt(point(i, k)[2] + point(i, k)[4]);
  addDetails((id, i) => {
    const px = (value) => `${value.toFixed(1)} px`;
    const now = isMissing(i) ? "no picture" : isLost(i) ? "lost" : states[3 * i + 2] ? "found again" : "followed";
    if (id > 0) {
      const [x, y] = point(i, id - 1), off = unsure(id - 1)(i).toFixed(2);
      return [["now", now], ["place", `${x.toFixed(1)}, ${y.toFixed(1)} px`], ["unsure by", `${off} px`]];
    }
    const [x, y, size] = pose.subarray(perPose * i + 9, perPose * i + 12);
    const turns = angleNames.map((name, k) => [name, `${angles[3 * i + k].toFixed(1)}°`]);
    const error = Number.isFinite(errors[i]) ? [["error", `${errors[i].toFixed(2)} px`]] : [];
    return [["now", now], ["place", `${x.toFixed(1)}, ${y.toFixed(1)} px`], ["size", px(size)], ...turns, ...error];
  });
  const curve = (value) => Float32Array.from({ length: view.count }, (_, i) => value(i));
  addPlot({ name: "selected ±", unit: "px", values: (id) => id > 0 ? curve(unsure(id - 1)) : null });
});
