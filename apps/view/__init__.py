"""`view.html`, the page of a run: its film with what was found drawn over it live, figures, plots and tables.

**What a run does.** While it goes, it writes the film small and without drawings (`film.FilmWriter`:
`film.mp4`, and in `view.npz` a row a frame of what is drawn). At the end the application fills a `page.Page`,
and `page.write_page` writes it. Who holds all frames anyway gives them to a `FilmWriter` at the end. Pages
without a film (of a batch, of events) are written by the same function.

**What an application adds.**

1. A function that makes the frame's arrays `{name: (k, ...) array}`, whose first axis may be of another
   length in each frame; it is called in a thread.
2. In its `page.py`, a function that fills a `Page` from the run's record and its summary. A plot more is a
   `Plot` more in its list.
3. `templates/layers/NAME.js`: one call of `addLayers((data) => …)`, which is given the layer's data when
   the page starts. All scripts of a page share one strict scope; a layer keeps its names inside that
   function. There

   - `addSwitch({name, label, key, on, draw(pen, i), hit(x, y, i)})` draws on the film: `pen` is a canvas
     context whose unit is a px of the source, edges of pixels at whole numbers (so points whose pixels'
     centres are at whole numbers need + 0.5); `pen.thin` is the width of one px of the screen. `hit` gives
     the id of the row at a place, or null;
   - `addPlot({name, unit, values})` shows a curve over the film's frames of what is selected: `values(id)`
     gives an array, or null;
   - `addDetails((id, i) => [[name, value], …])` fills the panel of what is selected;
   - `addPanel(title)` gives an element for something beside the film, as a view that turns;
   - `view.on("frame", (i) => …)`, `view.on("select", (id) => …)`, `view.on("draw", (i) => …)` tell of
     changes; `view.show(i)`, `view.select(id)`, `view.redraw()` make them; `view.frame`, `view.selected`,
     `view.count`, `view.times`, `view.numbers`, `view.size` are what is;
   - `addRows((id) => row)` gives rows of things that are too many to be listed, while one is selected;
   - `new Space(parent, {label, centre, reach, draw(space), pick(x, y)})` of `space.js` is a canvas to turn;
     `Solid` of `solid.js` draws dots and triangles on it by depth, `region(…)` an ellipse of a covariance;
   - `element(tag, properties, ...children)`, `svg(…)`, `startsOf(counts)`, `clamped(…)` of `data.js` help.

Without a film (`Film.path` is `None`) the page has a slider over time only, and layers draw on a blank
page.
"""
