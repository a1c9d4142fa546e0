// Buttons, slider and keys.

const PLAY = byId("play").querySelector("path").getAttribute("d"), PAUSE = "M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z";
const SPEEDS = [0.125, 0.25, 0.5, 1, 2, 4, 8];

function beginPlayer(clock) {
  const seek = byId("seek"), play = byId("play"), speed = byId("speed");
  seek.max = view.count - 1;
  for (const value of SPEEDS) speed.append(new Option(`${value}×`, value, value === 1, value === 1));

  const by = (n) => (event) => { clock.pause(); view.show(view.frame + (event.shiftKey ? 10 * n : n)); };
  const to = (i) => () => { clock.pause(); view.show(i); };
  const playOrPause = () => (clock.playing ? clock.pause() : clock.play());
  const faster = (n) => () => {
    clock.speed = SPEEDS[clamped(SPEEDS.indexOf(clock.speed) + n, 0, SPEEDS.length - 1)];
  };
  byId("start").addEventListener("click", to(0));
  byId("back").addEventListener("click", by(-1));
  play.addEventListener("click", playOrPause);
  byId("step").addEventListener("click", by(1));
  byId("end").addEventListener("click", to(view.count - 1));
  seek.addEventListener("input", () => { clock.pause(); view.show(Number(seek.value)); });
  speed.addEventListener("change", () => { clock.speed = Number(speed.value); });

  addKey(" ", "play or pause", playOrPause);
  addKey("ArrowLeft", "one frame back (with shift ten)", by(-1));
  addKey("ArrowRight", "one frame on (with shift ten)", by(1));
  addKey("Home", "to the first frame", to(0));
  addKey("End", "to the last frame", to(view.count - 1));
  addKey("+", "faster", faster(1));
  addKey("-", "slower", faster(-1));
  addKey("Escape", "select nothing", () => view.select(null));

  view.on("seek", (i) => clock.seek(i));
  view.on("frame", (i) => {
    seek.value = i;
    seek.setAttribute("aria-valuetext", frameName(i));
    byId("clock").textContent = frameName(i);
  });
  clock.onchange(() => {
    play.querySelector("path").setAttribute("d", clock.playing ? PAUSE : PLAY);
    play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
    speed.value = clock.speed;
  });
}

/** Keys work wherever they have no meaning of their own. */
function beginKeys() {
  const dialog = byId("keys");
  const help = () => dialog.showModal();
  addKey("?", "these keys", help);
  byId("help").addEventListener("click", help);
  const named = { " ": "space", ArrowLeft: "←", ArrowRight: "→", "-": "−" };
  for (const { key, text } of keys) {
    byId("key-list").append(
      element("dt", {}, element("kbd", { textContent: named[key] ?? key })), element("dd", { textContent: text }),
    );
  }
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || dialog.open) return;
    const at = event.target;
    if (at.matches("input[type=text], textarea, select")) return;
    if (event.key === " " && at.matches("button, input, summary, [role=option]")) return;
    if (at.matches("input[type=range]") && event.key !== " " && /^(Arrow|Home|End|Page)/.test(event.key)) return;
    const does = keys.find(({ key }) => key === event.key)?.does;
    if (!does) return;
    event.preventDefault();
    does(event);
  });
}

/** On paper a film is the picture that it shows: not every browser prints what a video shows. */
function beginPrint(video) {
  const still = byId("still");
  addEventListener("beforeprint", () => {
    if (!video.videoWidth) return;
    [still.width, still.height, still.hidden] = [video.videoWidth, video.videoHeight, false];
    still.style.cssText = video.style.cssText;
    still.getContext("2d").drawImage(video, 0, 0);
  });
  addEventListener("afterprint", () => { still.hidden = true; });
}
