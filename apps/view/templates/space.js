// Something in space, drawn orthographically on a canvas of its own, turned by mouse, touch and keys.

const PICKED = "#ff3b30"; // what is selected
const REGION_OF_2 = 4.605, REGION_OF_3 = 6.251; // squared Mahalanobis distances that hold 90 % of a Gaussian

/** The ellipse `size` (squared) about a place, of a covariance xx, xy, yy. */
function region(pen, x, y, xx, xy, yy, size) {
  const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
  const radius = (value) => Math.sqrt(Math.max(size * value, 0));
  pen.beginPath();
  pen.ellipse(x, y, radius(middle + apart), radius(middle - apart), Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
}

/** R C R^T of a rotation by rows and a covariance xx, xy, xz, yy, yz, zz. */
function turnedCovariance(rotation, [xx, xy, xz, yy, yz, zz]) {
  const rows = [0, 3, 6].map((k) => rotation.subarray(k, k + 3));
  const times = rows.map(([a, b, c]) => [xx * a + xy * b + xz * c, xy * a + yy * b + yz * c, xz * a + yz * b + zz * c]);
  const entry = (r, s) => rows[r][0] * times[s][0] + rows[r][1] * times[s][1] + rows[r][2] * times[s][2];
  return [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)];
}

/** A colour "#rrggbb", mixed with another one. */
function mixed(colour, other, share) {
  const parts = (text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16));
  const [one, two] = [parts(colour), parts(other)];
  return `rgb(${one.map((value, k) => Math.round(value + share * (two[k] - value))).join()})`;
}

/** What a variable of the style sheet is, as the reader's light or dark setting has it. */
function inkOf(name) {
  const probe = element("i", { style: `color: var(${name})`, hidden: true });
  document.body.append(probe);
  const ink = getComputedStyle(probe).color;
  probe.remove();
  return ink;
}

/**
 * The canvas; x points right, y down, z away from the viewer. `draw(space)` draws on `space.pen`, whose unit is a px
 * of the page; `pick(x, y)` is called with a place that was clicked. `reach` is what fits around `centre`.
 */
class Space {
  constructor(parent, { label, centre = [0, 0, 0], reach, draw, pick }) {
    Object.assign(this, { centre, reach, drawing: draw, pick, held: new Map(), due: false, inSight: false });
    const keys = "Arrow keys rotate it, plus and minus change its size, 0 resets.";
    this.canvas = element("canvas", { className: "space", tabIndex: 0, role: "application", "aria-label": `${label}. ${keys}` });
    this.pen = this.canvas.getContext("2d");
    const hint = element("p", { className: "quiet hint", textContent: "Drag to rotate; + and − for the size; 0 or double click resets." });
    const large = element("button", { textContent: "Full screen", hidden: !document.fullscreenEnabled });
    large.addEventListener("click", () => this.canvas.requestFullscreen());
    parent.append(this.canvas, element("div", { className: "choices" }, hint, large));
    this.reset();
    const on = (event, does) => this.canvas.addEventListener(event, does);
    on("pointerdown", (event) => this.press(event));
    on("pointermove", (event) => this.drag(event));
    on("pointerup", (event) => this.release(event));
    on("pointercancel", (event) => this.held.delete(event.pointerId));
    on("keydown", (event) => this.key(event));
    on("dblclick", () => this.reset());
    on("wheel", (event) => this.wheel(event));
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    new IntersectionObserver(([{ isIntersecting }]) => {
      this.inSight = isIntersecting; // nothing is drawn where nobody looks
      this.redraw();
    }).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    for (const change of ["frame", "select"]) view.on(change, () => this.redraw());
  }

  reset() {
    [this.yaw, this.pitch, this.zoom] = [0, 0, 1];
    this.redraw();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = clamped(this.pitch + pitch, -Math.PI / 2, Math.PI / 2);
    this.redraw();
  }

  magnify(factor) {
    this.zoom = clamped(this.zoom * factor, 0.2, 20);
    this.redraw();
  }

  press(event) {
    this.held.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.canvas.setPointerCapture(event.pointerId);
    this.moved = 0;
  }

  drag(event) {
    const before = this.held.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.offsetX - before[0], event.offsetY - before[1]];
    const apart = () => {
      const [a, b] = [...this.held.values()];
      return Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1);
    };
    const two = this.held.size === 2, distance = two ? apart() : 0;
    this.held.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.moved += Math.abs(dx) + Math.abs(dy);
    if (two) this.magnify(apart() / distance); else this.turn(-0.01 * dx, 0.01 * dy);
  }

  release(event) {
    if (this.held.delete(event.pointerId) && this.moved < 5) this.pick(event.offsetX, event.offsetY);
  }

  wheel(event) {
    if (document.activeElement !== this.canvas) return; // the page scrolls, until somebody has clicked here
    event.preventDefault();
    this.magnify(Math.exp(-0.002 * event.deltaY));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    const sizes = { "+": 1.1, "=": 1.1, "-": 1 / 1.1 };
    if (turns[event.key]) this.turn(...turns[event.key]);
    else if (sizes[event.key]) this.magnify(sizes[event.key]);
    else if (event.key === "0") this.reset();
    else return;
    event.preventDefault();
    event.stopPropagation(); // they have another meaning for the film
  }

  redraw() {
    if (this.due || !this.inSight) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.paint();
    });
  }

  paint() {
    const { canvas, pen } = this, fine = Math.min(window.devicePixelRatio || 1, 2);
    [this.width, this.height, this.fine] = [canvas.clientWidth, canvas.clientHeight, fine];
    if (!this.width || !this.height) return;
    const [columns, rows] = [Math.round(this.width * fine), Math.round(this.height * fine)];
    if (canvas.width !== columns || canvas.height !== rows) [canvas.width, canvas.height] = [columns, rows];
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    pen.clearRect(0, 0, this.width, this.height);
    this.scale = this.zoom * 0.5 * Math.min(this.width, this.height) / this.reach;
    const [sy, cy, sp, cp] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    // first about the vertical axis, then about the horizontal one
    this.rotation = Float64Array.of(cy, 0, sy, sp * sy, cp, -sp * cy, -cp * sy, sp, cp * cy);
    this.drawing(this);
  }

  /** Where a place is drawn: x and y in px of the page, and its depth, larger farther away. */
  place(x, y, z) {
    const [a, b, c, d, e, f, g, h, i] = this.rotation;
    const dx = x - this.centre[0], dy = y - this.centre[1], dz = z - this.centre[2];
    return [
      this.width / 2 + this.scale * (a * dx + b * dy + c * dz),
      this.height / 2 + this.scale * (d * dx + e * dy + f * dz),
      g * dx + h * dy + i * dz,
    ];
  }

  /** What is seen of a covariance xx, xy, xz, yy, yz, zz: its xx, xy, yy in the picture, squared px of the page. */
  spread(covariance) {
    const [xx, xy, , yy] = turnedCovariance(this.rotation, covariance), s = this.scale * this.scale;
    return [s * xx, s * xy, s * yy];
  }

  /** Axes to the right (red), up (green) and towards the viewer (blue), in the lower left corner. */
  axes() {
    const [x, y, length] = [26, this.height - 26, 18];
    for (const [dx, dy, dz, ink] of [[1, 0, 0, "#e5484d"], [0, -1, 0, "#30a46c"], [0, 0, -1, "#3e63dd"]]) {
      const [a, b, c, d, e, f] = this.rotation;
      this.pen.beginPath();
      this.pen.moveTo(x, y);
      this.pen.lineTo(x + length * (a * dx + b * dy + c * dz), y + length * (d * dx + e * dy + f * dz));
      this.pen.strokeStyle = ink;
      this.pen.lineWidth = 2;
      this.pen.stroke();
    }
  }
}
