// What is shown: the frame, what is selected, and who wants to know when that changes.

const data = unpacked(JSON.parse(byId("data").textContent));

const view = {
  data,
  size: data.size,               // [width, height] of the source, px
  numbers: data.numbers ?? [],   // of the film's frames, 1-based
  times: data.times ?? [],       // of the film's frames, s
  count: data.numbers?.length ?? 0,
  frame: 0,                // index of the frame that is shown
  selected: null,          // id of a row
  rows: [],
  listeners: { frame: [], select: [], draw: [], seek: [] },

  on(event, listener) {
    this.listeners[event].push(listener);
  },

  tell(event, value) {
    for (const listener of this.listeners[event]) listener(value);
  },

  /** Go to a frame: the film is moved there as well. */
  show(i) {
    this.tell("seek", clamped(Math.round(i), 0, this.count - 1));
  },

  /** The film is at a frame. */
  at(i) {
    this.frame = i;
    this.tell("frame", i);
    this.tell("draw", i);
  },

  select(id) {
    this.selected = id;
    this.tell("select", id);
    this.tell("draw", this.frame);
  },

  redraw() {
    this.tell("draw", this.frame);
  },
};

/** Layers are begun one after the other when the page is ready, each with its data. */
const layers = [];
function addLayers(begin) {
  layers.push(begin);
}

const keys = [];

/** A key of the page: `does` is called when it is pressed anywhere but in a field. */
function addKey(key, text, does) {
  keys.push({ key, text, does });
}

function frameName(i) {
  return `frame ${view.numbers[i]}, ${view.times[i].toFixed(2)} s`;
}
