"use strict";
// A game of one contact: the gear turns past the sleeve, whoever fires wants the tooth in the gap.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const NAMES = ["slip", "slowing", "gap", "delay", "scatter", "slower"];
  const DEG_PER_RPM_S = 6;
  const LOOK_S = 1.2; // how long a contact is shown, seconds of the wall clock
  const dials = Object.fromEntries(NAMES.map((name) => [name, document.getElementById(name)]));
  const value = (name) => Number(dials[name].value);
  const words = document.getElementById("words");
  let teeth = null;
  let round = null;
  const score = { you: [0, 0], controller: [0, 0] };

  // Slip in rpm and phase in degrees at a time of the round, in seconds; the slip ends at zero.
  function motion(at_s) {
    const { slip, slowing, phase } = round;
    const stop_s = slowing > 0 ? slip / slowing : Infinity;
    const t = Math.min(at_s, stop_s);
    return {
      slip: Math.max(slip - slowing * t, 0),
      phase: phase + DEG_PER_RPM_S * (slip * t - 0.5 * slowing * t * t),
    };
  }

  // Normal numbers by Box and Muller; a game needs no seed.
  function normal() {
    return Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());
  }

  function begin() {
    const pitch = data.geometry.pitch_deg;
    teeth = new Teeth(document.getElementById("teeth"), { ...data.geometry, gap_deg: (pitch * value("gap")) / 100 });
    round = { slip: value("slip"), slowing: value("slowing"), phase: Math.random() * pitch, at_s: 0, fired: null };
    words.textContent = "";
  }

  function fire(who, delay_s = value("delay") / 1000) {
    if (round.fired) return;
    const late_s = (normal() * value("scatter")) / 1000;
    round.fired = { who, from_s: round.at_s, contact_s: round.at_s + Math.max(delay_s + late_s, 0.001) };
  }

  // The controller fires when the next gap it can still reach is just one delay away.
  function aim() {
    if (round.fired) return;
    const pitch = data.geometry.pitch_deg;
    const delay_s = value("delay") / 1000;
    const first = Math.ceil(motion(round.at_s + delay_s).phase / pitch);
    for (let ahead_s = 0; ahead_s < 3; ahead_s += 0.0002) {
      if (motion(round.at_s + delay_s + ahead_s).phase >= first * pitch) {
        round.planned = { at_s: round.at_s + ahead_s, delay_s };
        return;
      }
    }
    words.textContent = "The slip dies out before the next gap comes: brake less, or begin faster.";
  }

  function land() {
    const { shown, inside } = teeth.place(motion(round.fired.contact_s).phase, data.geometry.contact_mm);
    const who = round.fired.who;
    score[who][0] += 1;
    score[who][1] += inside ? 1 : 0;
    round.landed = performance.now();
    round.inside = inside;
    words.textContent = `${inside ? "In the gap" : "Tooth on tooth"}: ${shown >= 0 ? "+" : "−"}${Math.abs(shown).toFixed(2)}° ` +
      `from the middle, at ${motion(round.fired.contact_s).slip.toFixed(0)} rpm of slip.`;
    tell();
  }

  function tell() {
    const rows = Object.entries(score).map(([who, [fired, gap]]) => {
      const row = document.createElement("tr");
      const cells = [who, fired, gap, fired ? `${Math.round((100 * gap) / fired)} %` : "–"];
      for (const [i, text] of [...cells].entries()) {
        const cell = document.createElement("td");
        cell.textContent = text;
        if (i > 0) cell.className = "number";
        row.append(cell);
      }
      return row;
    });
    const chance = document.createElement("tr");
    for (const text of ["by chance", "", "", `${value("gap")} %`]) {
      const cell = document.createElement("td");
      cell.textContent = text;
      cell.className = "number";
      chance.append(cell);
    }
    chance.firstChild.className = "";
    document.querySelector("#score tbody").replaceChildren(...rows, chance);
  }

  let before = null;
  function tick(now) {
    const passed_s = before === null ? 0 : Math.min((now - before) / 1000, 0.1) / value("slower");
    before = now;
    if (round.landed) {
      if (now - round.landed > 1000 * LOOK_S) begin();
    } else {
      round.at_s += passed_s;
      if (round.planned && !round.fired && round.at_s >= round.planned.at_s) {
        round.at_s = round.planned.at_s;
        fire("controller", round.planned.delay_s);
      }
      if (round.fired && round.at_s >= round.fired.contact_s) land();
      else draw();
      if (!round.fired && !round.planned && motion(round.at_s).slip === 0) begin();
    }
    requestAnimationFrame(tick);
  }

  function draw() {
    const { fired } = round;
    const share = fired ? (round.at_s - fired.from_s) / (fired.contact_s - fired.from_s) : 0;
    teeth.place(motion(round.at_s).phase, data.geometry.contact_mm * share * share);
  }

  for (const [name, dial] of Object.entries(dials)) {
    const show = () => { document.getElementById(`${name}-value`).textContent = dial.value; };
    dial.addEventListener("input", () => { show(); if (name !== "slower") begin(); tell(); });
    show();
  }
  document.getElementById("fire").addEventListener("click", () => fire("you"));
  document.getElementById("controller").addEventListener("click", aim);
  document.getElementById("again").addEventListener("click", () => {
    for (const who of Object.keys(score)) score[who] = [0, 0];
    tell();
  });
  document.addEventListener("keydown", (event) => {
    if (event.code !== "Space") return;
    event.preventDefault();
    fire("you");
  });
  begin();
  tell();
  requestAnimationFrame(tick);
})();
