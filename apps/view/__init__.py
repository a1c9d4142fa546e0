"""`view.html`: the film of a run with what was found drawn over it live, in one self-contained page.

**What a run does.** While it goes, `FilmRun` writes the film small and without drawings (`film.FilmWriter`:
`film.mp4`, and in `view.npz` a row a frame of whatever the application's `FilmRun.drawn` gives to draw). At
the end `FilmRun.view` says what is on the page (`page.View`), and `page.write_view` writes it. Who holds
all frames anyway gives them to a `FilmWriter` at the end.

**What an application adds.**

1. `FilmRun.drawn(belief, found)`: a function that makes the frame's arrays `{name: (k, ...) array}`, whose
   first axis may be of another length in each frame; it is called in a thread. An application that has its
   rows elsewhere (`poses.npz`) leaves it out, and takes those of the frames `film.numbers`: of a long run,
   only the last part is on its page.
2. `FilmRun.view(film)`: a `View` of `layers` (by the name of a file in `templates/layers/` without `.js`,
   its data: anything JSON takes, and arrays, which arrive as typed arrays), `rows` of the timeline with
   spans in which something was seen or only predicted, and `plots` over time. Index i is the i-th frame of
   the film everywhere.
3. `templates/layers/NAME.js`: one call of `addLayers((data) => …)`, which is given the layer's data when
   the page starts. All scripts of a page share one strict scope; a layer keeps its names inside that
   function. There

   - `addSwitch({name, label, key, on, draw(pen, i), hit(x, y, i)})` draws on the film: `pen` is a canvas
     context whose unit is a px of the source, edges of pixels at whole numbers (so points whose pixels'
     centres are at whole numbers need + 0.5); `pen.thin` is the width of one px of the screen. `hit` gives
     the id of the row at a place, or null;
   - `addRow({id, label, colour, spans})` and `addPlot({name, unit, values})` do what `rows` and `plots` of
     `View` do; `values` may be a function of the selected id, for plots of what is selected;
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
