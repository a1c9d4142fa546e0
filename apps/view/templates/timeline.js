// A row for everything that is followed: when it was seen, and when only predicted.

const SEEN = 0;

/** Something that is followed; `spans` are triples of first frame, last frame, kind. */
function addRow({ id, label, colour, spans }) {
  view.rows.push({ id, label, colour, spans });
}

const makers = [];

/** Things that are too many to be listed: `make(id)` gives the row of one, which is shown while it is selected. */
function addRows(make) {
  makers.push(make);
}

function rowOf(id) {
  const row = view.rows.find((row) => row.id === id);
  return row ?? makers.map((make) => make(id)).find((made) => made) ?? null;
}

/** First and last frame of a row. */
function lifeOf(row) {
  return [row.spans[0], row.spans[row.spans.length - 2]];
}

function beginTimeline() {
  if (!view.rows.length) return;
  const list = element("div", { className: "rows", tabIndex: 0, role: "listbox", "aria-label": "Timeline" });
  const lanes = element("div", { className: "lanes", role: "none" });
  const options = new Map();
  let unlisted = null; // the selected one, if it is none of them
  const optionOf = (row) => {
    const option = element("div", { className: "row", role: "option", id: `row-${row.id}`, "aria-selected": "false" },
      element("span", { className: "label" }, element("i", { style: `background:${row.colour}` }), row.label), strip(row));
    option.addEventListener("click", (event) => {
      view.select(row.id);
      const bar = option.querySelector("svg").getBoundingClientRect();
      const share = (event.clientX - bar.left) / bar.width;
      view.show(share >= 0 ? share * view.count - 0.5 : clamped(view.frame, ...lifeOf(row)));
    });
    return option;
  };
  for (const row of view.rows) {
    const option = optionOf(row);
    options.set(row.id, option);
    lanes.append(option);
  }
  /** Have a row be seen in its list; the page itself stays where it is. */
  const reveal = ({ offsetTop, offsetHeight }) => {
    const most = offsetTop, least = offsetTop + offsetHeight - list.clientHeight;
    if (list.scrollTop > most || list.scrollTop < least) list.scrollTop = list.scrollTop > most ? most : least;
  };
  list.addEventListener("keydown", (event) => {
    const by = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const at = view.rows.findIndex((row) => row.id === view.selected);
    const row = view.rows[clamped(at + by, 0, view.rows.length - 1)];
    view.select(row.id);
    view.show(clamped(view.frame, ...lifeOf(row)));
  });
  view.on("select", (id) => {
    for (const [of, option] of options) option.setAttribute("aria-selected", of === id);
    unlisted?.remove();
    unlisted = null;
    if (id !== null && !options.has(id)) lanes.prepend(unlisted = optionOf(rowOf(id)));
    const option = options.get(id) ?? unlisted;
    option?.setAttribute("aria-selected", true);
    list.setAttribute("aria-activedescendant", option ? option.id : "");
    if (option) reveal(option);
  });
  const cursor = element("div", { className: "cursor" });
  const begins = view.rows.map((row) => row.spans[0]);
  const ascending = begins[begins.length - 1] > begins[0] && begins.every((first, k) => !k || begins[k - 1] <= first);
  view.on("frame", (i) => {
    cursor.style.setProperty("--at", (i + 0.5) / view.count);
    if (view.selected === null && ascending) reveal(options.get(view.rows[lastAtMost(begins, i)].id));
  });
  lanes.append(cursor);
  list.append(lanes);
  byId("timeline").append(list);
  byId("timeline").hidden = false;
}

/** The spans of a row as one picture, a frame a unit. */
function strip(row) {
  const paths = ["", ""];
  for (let k = 0; k < row.spans.length; k += 3) {
    const kind = row.spans[k + 2] === SEEN ? 0 : 1;
    paths[kind] += `M${row.spans[k]} 0H${row.spans[k + 1] + 1}V1H${row.spans[k]}Z`;
  }
  return svg("svg", { viewBox: `0 0 ${view.count} 1`, preserveAspectRatio: "none", "aria-hidden": "true", fill: row.colour },
    svg("path", { d: paths[1], opacity: 0.35 }), svg("path", { d: paths[0] }));
}
