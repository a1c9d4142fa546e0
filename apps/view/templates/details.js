// What is known of what is selected, as the film moves; and room beside the film for more.

const details = [];

/** `rows(id, i)` gives pairs of name and value of what is selected, in frame i. */
function addDetails(rows) {
  details.push(rows);
}

/** An element for something beside the film. */
function addPanel(title) {
  const body = element("div", {});
  byId("panels").append(element("section", { className: "card", "aria-label": title }, element("h2", { textContent: title }), body));
  return body;
}

function beginDetails() {
  const panel = byId("details");
  const show = () => {
    const row = view.selected === null ? null : rowOf(view.selected);
    if (row === null) {
      panel.replaceChildren(element("p", { className: "quiet", textContent: "Click on an object in the video, or on its row below." }));
      return;
    }
    const [first, last] = lifeOf(row);
    const pairs = [
      ["from", frameName(first)], ["to", frameName(last)],
      ...details.flatMap((rows) => rows(row.id, view.frame)),
    ];
    const list = element("dl", {});
    for (const [name, value] of pairs) list.append(element("dt", { textContent: name }), element("dd", { textContent: value }));
    panel.replaceChildren(element("p", { className: "who" }, element("i", { style: `background:${row.colour}` }), row.label), list);
  };
  view.on("select", show);
  view.on("frame", () => { if (view.selected !== null) show(); });
  show();
}
