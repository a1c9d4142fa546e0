// Everything is there: begin.

const bytes = byId("film-bytes").textContent;
const video = byId("video");
let clock;
if (bytes) {
  clock = filmClock(video);
  video.src = URL.createObjectURL(new Blob([bytesOf(bytes)], { type: "video/mp4" }));
  byId("film-bytes").remove();
} else {
  clock = freeClock();
  video.remove();
}
if (data.frames > view.count) {
  byId("part").textContent = `Frames ${view.numbers[0]} to ${view.numbers[view.count - 1]}, ${view.count} of ${data.frames}: this page holds the last part of a long run.`;
  byId("part").hidden = false;
}
beginPlayer(clock);
for (const row of data.rows) addRow(row);
for (const plot of data.plots) addPlot(plot);
layers.forEach((begin, k) => begin(Object.values(data.layers)[k]));
beginStage();
beginTimeline();
beginPlots();
beginDetails();
beginKeys();
view.at(0);
