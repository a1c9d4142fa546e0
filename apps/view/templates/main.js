// Everything is there: begin the player.

const bytes = byId("film-bytes").textContent;
const video = byId("video");
let clock;

/** Something to be said above everything. */
function tell(text) {
  byId("part").textContent = text;
  byId("part").hidden = false;
}

if (bytes) {
  clock = filmClock(video);
  video.addEventListener("error", () => {
    tell("This browser cannot show the video, which is H.264; the results are drawn nevertheless.");
  });
  video.src = URL.createObjectURL(new Blob([bytesOf(bytes)], { type: "video/mp4" }));
  byId("film-bytes").remove();
} else {
  clock = freeClock();
  video.remove();
}
if (data.run.frames > view.count) {
  tell(`The video has frames ${view.numbers[0]} to ${view.numbers[view.count - 1]}, ${view.count} of ${data.run.frames}: the others are not on this page.`);
}
beginPlayer(clock);
for (const row of data.rows) addRow(row);
layers.forEach((begin, k) => begin(Object.values(data.layers)[k]));
beginStage();
beginTimeline();
beginDetails();
beginKeys();
beginPrint(video);
