"use strict";
// Teeth of a sleeve and of its gear, unrolled: the gear's turn past the sleeve, the sleeve moves in.
// Angles in degrees, from the middle of the sleeve's gap to the middle of the gear's tooth.
class Teeth {
  static WIDTH = 900;
  static HEIGHT = 250;
  static PITCHES = 3;
  static FACE = 132; // where the front of the gear's teeth stands
  static LENGTH = 58; // of a tooth
  static ROOM = 64; // between the fronts when the sleeve is in neutral

  constructor(place, geometry) {
    this.geometry = geometry;
    this.deg = Teeth.WIDTH / (Teeth.PITCHES * geometry.pitch_deg); // pixels a degree
    this.mm = Teeth.ROOM / geometry.contact_mm; // pixels a millimetre of the sleeve's way
    const svg = Teeth.make("svg", {
      viewBox: `0 0 ${Teeth.WIDTH} ${Teeth.HEIGHT}`, role: "img", class: "teeth",
      "aria-label": "teeth of sleeve and gear",
    });
    this.gear = this.comb("gear", Teeth.FACE, 1);
    this.sleeve = this.comb("sleeve", Teeth.FACE - Teeth.ROOM, -1, geometry.pitch_deg / 2);
    const middle = Teeth.make("line", {
      x1: Teeth.WIDTH / 2, x2: Teeth.WIDTH / 2, y1: 0, y2: Teeth.HEIGHT, class: "middle",
    });
    svg.append(middle, this.gear, this.sleeve);
    place.replaceChildren(svg);
    this.svg = svg;
  }

  // As the browser names it: the page itself holds no address at all.
  static NAMESPACE = Object.assign(document.createElement("div"), { innerHTML: "<svg></svg>" })
    .firstChild.namespaceURI;

  static make(name, attributes) {
    const element = document.createElementNS(Teeth.NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    return element;
  }

  // A body with teeth: `front` of the teeth, `side` +1 where the body lies below them.
  comb(name, front, side, shift_deg = 0) {
    const group = Teeth.make("g", { class: name });
    const { pitch_deg, gap_deg } = this.geometry;
    const half = ((pitch_deg - gap_deg) / 4) * this.deg; // tooth of the gear and of the sleeve alike
    const root = front + side * Teeth.LENGTH;
    for (let k = -Teeth.PITCHES - 1; k <= Teeth.PITCHES + 1; k += 1) {
      const x = Teeth.WIDTH / 2 + (k * pitch_deg + shift_deg) * this.deg;
      const edge = Math.min(4, half / 3);
      const tooth = Teeth.make("path", {
        d: `M${x - half} ${root} V${front + side * edge} L${x - half + edge} ${front} ` +
          `H${x + half - edge} L${x + half} ${front + side * edge} V${root} Z`,
      });
      if (k === 0 && name === "gear") tooth.setAttribute("id", "aimed-tooth");
      group.append(tooth);
    }
    const y = Math.min(root, root + side * 40);
    group.append(Teeth.make("rect", { x: -Teeth.WIDTH, y, width: 3 * Teeth.WIDTH, height: 40 }));
    return group;
  }

  // Draws tooth and sleeve; `phase_deg` may be any angle: the nearest pitch is drawn.
  place(phase_deg, travel_mm) {
    const { pitch_deg } = this.geometry;
    const shown = phase_deg - pitch_deg * Math.round(phase_deg / pitch_deg);
    this.gear.setAttribute("transform", `translate(${shown * this.deg} 0)`);
    this.sleeve.setAttribute("transform", `translate(0 ${travel_mm * this.mm})`);
    const inside = Math.abs(shown) < this.geometry.gap_deg / 2;
    this.svg.classList.toggle("inside", inside);
    return { shown, inside };
  }
}
