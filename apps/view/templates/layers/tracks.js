// Objects in front of the background: boxes, outlines, identities, paths.

addLayers(({ boxes, ids, counts, outline, corners, polygons }) => {
  const starts = startsOf(counts), shapes = startsOf(polygons), points = startsOf(corners);
  const colours = new Map(view.rows.map((row) => [row.id, row.colour]));

  addSwitch({
    name: "outlines", key: "o", draw(pen, i) {
      pen.strokeStyle = "#ff3b30";
      pen.lineWidth = 1.4 * pen.thin;
      pen.beginPath();
      for (let shape = shapes[i]; shape < shapes[i + 1]; shape++) {
        for (let k = points[shape]; k < points[shape + 1]; k++) {
          pen[k === points[shape] ? "moveTo" : "lineTo"](outline[2 * k] + 0.5, outline[2 * k + 1] + 0.5);
        }
        pen.closePath();
      }
      pen.stroke();
    },
  });

  addSwitch({
    name: "boxes", key: "b",
    draw(pen, i) {
      for (let k = starts[i]; k < starts[i + 1]; k++) {
        pen.strokeStyle = colours.get(ids[k]);
        pen.lineWidth = (ids[k] === view.selected ? 3.5 : 2) * pen.thin;
        pen.strokeRect(...boxes.subarray(4 * k, 4 * k + 4));
      }
    },
    hit(x, y, i) {
      let best = null, least = Infinity;
      for (let k = starts[i]; k < starts[i + 1]; k++) {
        const [left, top, width, height] = boxes.subarray(4 * k, 4 * k + 4);
        const inside = x >= left && x <= left + width && y >= top && y <= top + height;
        if (inside && width * height < least) { least = width * height; best = ids[k]; }
      }
      return best;
    },
  });
});
