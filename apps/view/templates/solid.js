// Pixels with a depth and an owner each, into which dots and triangles are drawn in any order.

class Solid {
  begin(space) {
    const [columns, rows] = [Math.round(space.width * space.fine), Math.round(space.height * space.fine)];
    if (!this.picture || this.picture.width !== columns || this.picture.height !== rows) {
      this.picture = new ImageData(columns, rows);
      this.colours = new Uint32Array(this.picture.data.buffer);
      this.depths = new Float32Array(columns * rows);
      this.owners = new Int32Array(columns * rows);
      this.canvas = document.createElement("canvas");
      [this.canvas.width, this.canvas.height] = [columns, rows];
    }
    this.space = space;
    this.colours.fill(0);
    this.depths.fill(Infinity);
    this.owners.fill(-1);
  }

  /** Draw what was put in. */
  end() {
    this.canvas.getContext("2d").putImageData(this.picture, 0, 0);
    this.space.pen.drawImage(this.canvas, 0, 0, this.space.width, this.space.height);
  }

  /** Places x, y, z (3 each) in space as x, y in px of the picture, and depth. */
  placed(places, into) {
    const [a, b, c, d, e, f, g, h, i] = this.space.rotation;
    const [x0, y0, z0] = this.space.centre;
    const scale = this.space.scale * this.space.fine;
    const [left, top] = [this.picture.width / 2, this.picture.height / 2];
    for (let k = 0; k < places.length; k += 3) {
      const x = places[k] - x0;
      const y = places[k + 1] - y0;
      const z = places[k + 2] - z0;
      into[k] = left + scale * (a * x + b * y + c * z);
      into[k + 1] = top + scale * (d * x + e * y + f * z);
      into[k + 2] = g * x + h * y + i * z;
    }
    return into;
  }

  /** A disc about every place, with a darker rim; what is farther away is paler. `inks` are 0xBBGGRR. */
  dots(placed, inks, radius, reach) {
    const [width, height] = [this.picture.width, this.picture.height];
    const across = Math.max(1, radius * this.space.fine);
    const offsets = [];
    for (let y = -Math.ceil(across); y <= across; y++)
      for (let x = -Math.ceil(across); x <= across; x++)
        if (Math.hypot(x, y) <= across) offsets.push(x, y, Math.hypot(x, y) > across - this.space.fine && across > 2);
    for (let k = 0, point = 0; k < placed.length; k += 3, point++) {
      const depth = placed[k + 2];
      if (!(Math.abs(depth) < Infinity)) continue;
      const column = Math.round(placed[k]);
      const row = Math.round(placed[k + 1]);
      const pale = Math.max(0, Math.min(1, 0.5 + depth / (2 * reach)));
      const alpha = Math.round(255 - 165 * pale) << 24;
      const ink = inks[point] | alpha;
      const rim = ((inks[point] >> 1) & 0x7f7f7f) | alpha;
      for (let j = 0; j < offsets.length; j += 3) {
        const x = column + offsets[j];
        const y = row + offsets[j + 1];
        if (x < 0 || y < 0 || x >= width || y >= height) continue;
        const pixel = y * width + x;
        if (depth >= this.depths[pixel]) continue;
        this.depths[pixel] = depth;
        this.colours[pixel] = offsets[j + 2] ? rim : ink;
        this.owners[pixel] = point;
      }
    }
  }

  /**
   * Triangles, lit from the viewer's upper left. Their colour is `ink`, or where there is a texture, `width` wide with
   * `pixels` 0xAABBGGRR, that of the place `on` (2 an end) in it, unless nothing is known there (0). The owner of a
   * pixel is the nearest corner.
   */
  triangles(corners, placed, ink, texture, on) {
    const { width, height } = this.picture;
    const deep = this.space.scale * this.space.fine;
    for (let t = 0; t < corners.length; t += 3) {
      const p = corners[t], q = corners[t + 1], r = corners[t + 2];
      const ax = placed[3 * p], ay = placed[3 * p + 1], az = placed[3 * p + 2];
      const bx = placed[3 * q] - ax, by = placed[3 * q + 1] - ay, bz = placed[3 * q + 2] - az;
      const cx = placed[3 * r] - ax, cy = placed[3 * r + 1] - ay, cz = placed[3 * r + 2] - az;
      const area = bx * cy - by * cx;
      if (!area) continue;
      // the normal towards the viewer
      const side = area < 0 ? 1 : -1, nx = side * deep * (by * cz - bz * cy), ny = side * deep * (bz * cx - bx * cz);
      const towards = (-0.35 * nx - 0.45 * ny + 0.82 * Math.abs(area)) / Math.hypot(nx, ny, area);
      const light = texture ? 0.75 + 0.25 * Math.max(towards, 0) : 0.35 + 0.65 * Math.max(towards, 0);
      const left = Math.max(0, Math.ceil(ax + Math.min(0, bx, cx)));
      const right = Math.min(width - 1, Math.floor(ax + Math.max(0, bx, cx)));
      const top = Math.max(0, Math.ceil(ay + Math.min(0, by, cy)));
      const bottom = Math.min(height - 1, Math.floor(ay + Math.max(0, by, cy)));
      for (let y = top; y <= bottom; y++) {
        for (let x = left; x <= right; x++) {
          const v = ((x - ax) * cy - (y - ay) * cx) / area, w = (bx * (y - ay) - by * (x - ax)) / area, u = 1 - v - w;
          if (u < 0 || v < 0 || w < 0) continue;
          const depth = az + v * bz + w * cz, pixel = y * width + x;
          if (depth >= this.depths[pixel]) continue;
          this.depths[pixel] = depth;
          this.owners[pixel] = u >= v && u >= w ? p : v >= w ? q : r;
          let colour = ink;
          if (texture) {
            const column = Math.round(u * on[2 * p] + v * on[2 * q] + w * on[2 * r]);
            const row = Math.round(u * on[2 * p + 1] + v * on[2 * q + 1] + w * on[2 * r + 1]);
            if (column >= 0 && column < texture.width) colour = texture.pixels[row * texture.width + column] || ink;
          }
          const red = light * (colour & 255), green = light * ((colour >> 8) & 255), blue = light * ((colour >> 16) & 255);
          this.colours[pixel] = 0xff000000 | (blue << 16) | (green << 8) | red;
        }
      }
    }
  }

  /** Whose pixel is at or near a place in CSS px; -1 if nobody's. */
  at(x, y) {
    const [width, height] = [this.picture.width, this.picture.height];
    const [column, row] = [Math.round(x * this.space.fine), Math.round(y * this.space.fine)];
    const within = Math.round(8 * this.space.fine);
    let [found, least] = [-1, Infinity];
    for (let j = Math.max(0, row - within); j <= Math.min(height - 1, row + within); j++)
      for (let i = Math.max(0, column - within); i <= Math.min(width - 1, column + within); i++) {
        const distance = Math.hypot(i - column, j - row);
        if (this.owners[j * width + i] >= 0 && distance < least) {
          found = this.owners[j * width + i];
          least = distance;
        }
      }
    return found;
  }
}

/** A JPEG in base 64 as a texture, when it is decoded. */
async function pixelsOf(jpeg) {
  const image = element("img", { src: `data:image/jpeg;base64,${jpeg}` });
  await image.decode();
  const { naturalWidth: width, naturalHeight: height } = image;
  const pen = element("canvas", { width, height }).getContext("2d");
  pen.drawImage(image, 0, 0);
  return { width, pixels: new Uint32Array(pen.getImageData(0, 0, width, height).data.buffer) };
}
