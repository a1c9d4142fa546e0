// What moves through the frames: the film, or where there is none a timer.

/** The film: the browser tells which picture it shows, so what is drawn over it is of the same frame. */
function filmClock(video) {
  const moments = view.data.moments;
  const middleOf = (i) => {
    const k = Math.min(i, view.count - 2);
    return moments[i] + (k < 0 ? 0.001 : (moments[k + 1] - moments[k]) / 2);
  };
  let wanted = null; // the frame that was last asked for, until the film is there
  const shown = (time) => {
    // of a fast film the last picture may not be told, or one before it later
    const i = video.ended ? view.count - 1 : lastAtMost(moments, time + 0.0005);
    if (wanted !== null && i !== wanted && video.seeking) return;
    wanted = null;
    if (i !== view.frame) view.at(i);
  };
  if ("requestVideoFrameCallback" in HTMLVideoElement.prototype) {
    const next = (_, about) => {
      shown(about.mediaTime);
      video.requestVideoFrameCallback(next);
    };
    video.requestVideoFrameCallback(next);
  } else {
    const next = () => {
      shown(video.currentTime);
      requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }
  video.addEventListener("ended", () => shown(video.currentTime));
  return {
    get playing() { return !video.paused && !video.ended; },
    get speed() { return video.playbackRate; },
    set speed(value) { video.playbackRate = value; },
    play() {
      if (view.frame === view.count - 1) this.seek(0);
      video.play().catch(() => {}); // a pause may come before it begins
    },
    pause() { video.pause(); },
    seek(i) {
      wanted = i;
      video.currentTime = middleOf(i);
      view.at(i);
    },
    onchange(listener) {
      for (const event of ["play", "pause", "ended", "ratechange"]) video.addEventListener(event, listener);
    },
  };
}

/** A timer over the times of the frames. */
function freeClock() {
  const times = view.times;
  const listeners = [];
  const changed = () => listeners.forEach((listener) => listener());
  let playing = false, speed = 1, since = 0, from = 0;
  const begin = () => { since = performance.now(); from = times[view.frame]; };
  const tick = (now) => {
    if (!playing) return;
    const i = lastAtMost(times, from + (now - since) / 1000 * speed);
    if (i !== view.frame) view.at(i);
    if (i === view.count - 1) { playing = false; changed(); } else requestAnimationFrame(tick);
  };
  return {
    get playing() { return playing; },
    get speed() { return speed; },
    set speed(value) { speed = value; begin(); changed(); },
    play() {
      if (view.frame === view.count - 1) view.at(0);
      playing = true;
      begin();
      requestAnimationFrame(tick);
      changed();
    },
    pause() { playing = false; changed(); },
    seek(i) { view.at(i); begin(); },
    onchange(listener) { listeners.push(listener); },
  };
}
