"use strict";
// The shift that is shown, in slow motion on the time axis of its traces.
class SlowMotion {
  static SLOWER = 50;

  constructor(geometry, figure) {
    this.geometry = geometry;
    this.figure = figure;
    this.block = document.getElementById("motion");
    this.teeth = new Teeth(document.getElementById("motion-teeth"), geometry);
    this.slider = document.getElementById("motion-time");
    this.button = document.getElementById("motion-play");
    this.words = document.getElementById("motion-words");
    this.cursor = document.createElement("div");
    this.cursor.className = "cursor";
    figure.parentElement.insertBefore(this.cursor, figure);
    this.slider.addEventListener("input", () => { this.stop(); this.at(Number(this.slider.value)); });
    this.button.addEventListener("click", () => (this.playing ? this.stop() : this.play()));
    window.addEventListener("resize", () => this.mark());
  }

  show(motion) {
    this.stop();
    this.motion = motion;
    this.block.hidden = !motion;
    this.cursor.hidden = !motion;
    if (!motion) return;
    const [first, last] = [motion.at_ms[0], motion.at_ms[motion.at_ms.length - 1]];
    this.slider.min = Math.ceil(first);
    this.slider.max = Math.floor(last);
    this.at(motion.contact_ms);
  }

  // Tooth and sleeve at a time, between two samples on a straight line.
  static between(times, values, at) {
    let low = 0;
    let high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= at) low = middle; else high = middle;
    }
    const share = Math.min(Math.max((at - times[low]) / (times[high] - times[low]), 0), 1);
    return values[low] + share * (values[high] - values[low]);
  }

  at(time_ms) {
    const { motion } = this;
    this.time_ms = time_ms;
    const phase = SlowMotion.between(motion.at_ms, motion.phase_deg, time_ms);
    const k = Math.min(Math.max(Math.round(time_ms - motion.sleeve_from_ms), 0), motion.sleeve_mm.length - 1);
    const travel = motion.sleeve_mm[k];
    const { shown, inside } = this.teeth.place(phase, travel);
    if (document.activeElement !== this.slider) this.slider.value = time_ms;
    const left = time_ms - motion.contact_ms;
    const when = Math.abs(left) < 0.05 ? "contact" : `${Math.abs(left).toFixed(1)} ms ${left < 0 ? "before" : "after"} contact`;
    this.words.textContent = `${time_ms.toFixed(1)} ms, ${when}: tooth ${shown >= 0 ? "+" : "−"}` +
      `${Math.abs(shown).toFixed(2)}° from the middle of the gap${inside ? ", inside it" : ""}; ` +
      `sleeve ${travel.toFixed(1)} mm`;
    this.mark();
  }

  // A line through the traces at the time shown, below the names of moments.
  mark() {
    const layout = this.figure._fullLayout;
    if (!this.motion || !layout || !layout.xaxis) return;
    const x = layout.xaxis._offset + layout.xaxis.l2p(this.time_ms);
    this.cursor.style.left = `${this.figure.offsetLeft + x}px`;
    const { t: above_px, h: high_px } = layout._size;
    this.cursor.style.top = `${this.figure.offsetTop + above_px}px`;
    this.cursor.style.height = `${high_px}px`;
    const [from, to] = layout.xaxis.range;
    this.cursor.hidden = this.time_ms < from || this.time_ms > to;
  }

  play() {
    this.playing = true;
    this.button.textContent = "❚❚ pause";
    const last = Number(this.slider.max);
    if (this.time_ms >= last - 1) this.at(Number(this.slider.min));
    let before = null;
    const tick = (now) => {
      if (!this.playing) return;
      if (before !== null) this.at(Math.min(this.time_ms + (now - before) / SlowMotion.SLOWER, last));
      before = now;
      if (this.time_ms >= last) this.stop(); else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  stop() {
    this.playing = false;
    this.button.textContent = "▶ play";
  }
}
