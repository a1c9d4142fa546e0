// What happened in zones and at lines: a list that follows the film, and leads to its moments.

addLayers((events) => {
  if (!events.length) return;
  const frames = events.map(({ frame }) => lastAtMost(view.numbers, frame));
  const list = element("select", { size: Math.min(8, Math.max(2, events.length)), className: "events", "aria-label": "Events" });
  const over = ["entered", "left", "crossed"]; // a border; the others are in a zone, or nowhere
  for (const { time, id, kind, zone, more } of events) {
    const where = !zone ? "" : over.includes(kind) ? ` ${zone}` : ` in ${zone}`;
    list.append(new Option(`${time.toFixed(2)} s · ${id} ${kind}${where}${more ? `, ${more}` : ""}`));
  }
  const go = () => {
    if (list.selectedIndex < 0) return;
    view.select(events[list.selectedIndex].id);
    view.show(frames[list.selectedIndex]);
  };
  list.addEventListener("change", go);
  list.addEventListener("click", go);
  addPanel("Events").append(list);
  addKey("e", "the next event", () => {
    const next = frames.findIndex((frame) => frame > view.frame);
    if (next < 0) return;
    list.selectedIndex = next;
    go();
  });
  view.on("frame", (i) => { // of several at a time, that which was chosen stays
    if (frames[list.selectedIndex] !== i) list.selectedIndex = frames.findLastIndex((frame) => frame <= i);
  });
});
