"use strict";
// Draws one shift at a time; which one is said by the part of the address behind '#'. Only then is
// its figure read: reading those of hundreds of shifts would delay the opening of the page.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const keys = data.shifts;
  const shiftOf = (key) => JSON.parse(document.getElementById("data-" + key).textContent);
  const buttons = ["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"];
  const config = { responsive: true, displaylogo: false, modeBarButtons: [buttons] };
  const bare = { responsive: true, displayModeBar: false };
  const figure = document.getElementById("figure");
  let chosen = null;

  // On a narrow page the traces take the whole width; the legends lie over them.
  const narrow = matchMedia("(max-width: 600px)");

  function fit(layout) {
    if (!narrow.matches) return;
    layout.margin = { ...layout.margin, l: Math.min(layout.margin.l, 120) * 0.68, r: 4 };
    layout.font = { ...layout.font, size: 10 };
    layout.xaxis.domain = [0, 1];
    for (const [name, own] of Object.entries(layout)) {
      if (name.startsWith("legend")) {
        layout[name] = { ...own, x: 0, orientation: "h", font: { size: 9 }, bgcolor: "rgba(255,255,255,.6)" };
      }
      if (name.startsWith("yaxis")) layout[name] = { ...own, title: { ...own.title, standoff: 0 }, nticks: 5 };
    }
  }

  function draw(shift) {
    const layout = { ...data.common, annotations: shift.annotations };
    layout.shapes = data.common.shapes.concat(shift.shapes);
    for (const [name, own] of Object.entries(shift.axes)) {
      layout[name] = { ...data.common[name], ...own };
    }
    const own = structuredClone(layout);
    fit(own);
    Plotly.react(figure, shift.data, own, config);
  }

  function tell(shift) {
    document.getElementById("title").textContent = shift.title;
    document.getElementById("cause").textContent = shift.cause;
    const rows = shift.account.map((cells) => {
      const row = document.createElement("tr");
      for (const [i, text] of cells.entries()) {
        const cell = document.createElement("td");
        cell.textContent = text;
        if (i > 0) cell.className = "number";
        row.append(cell);
      }
      return row;
    });
    document.querySelector("#account tbody").replaceChildren(...rows);
  }

  function choose(key, reveal) {
    if (!keys.includes(key) || key === chosen) return;
    if (chosen) document.getElementById(chosen).classList.remove("chosen");
    chosen = key;
    const row = document.getElementById(key);
    row.classList.add("chosen");
    if (reveal) {
      const box = row.closest(".scroll");
      box.scrollTop = row.offsetTop - box.clientHeight / 2;
    }
    const shift = shiftOf(key);
    tell(shift);
    draw(shift);
    slow.show(shift.motion);
  }

  function go(key) {
    history.replaceState(null, "", "#" + key);
    choose(key, true);
  }

  function step(by) {
    const next = keys[keys.indexOf(chosen) + by];
    if (next) go(next);
  }

  for (const [name, overview] of Object.entries(data.overview)) {
    const place = document.getElementById(name);
    Plotly.newPlot(place, overview.data, overview.layout, bare);
    place.on("plotly_click", (event) => go(event.points[0].customdata));
  }
  if (keys.length === 0) return;
  const slow = new SlowMotion(data.geometry, figure);
  for (const key of keys) {
    document.getElementById(key).addEventListener("click", (event) => {
      event.preventDefault();
      go(key);
    });
  }
  document.getElementById("before").addEventListener("click", () => step(-1));
  document.getElementById("after").addEventListener("click", () => step(1));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.type === "range") return;
    if (event.key === "ArrowLeft") step(-1);
    if (event.key === "ArrowRight") step(1);
  });
  narrow.addEventListener("change", () => draw(shiftOf(chosen)));
  window.addEventListener("hashchange", () => choose(location.hash.slice(1), true));
  choose(location.hash.slice(1), true);
  if (chosen === null) choose(data.first, true);
  figure.on("plotly_afterplot", () => slow.mark());
})();
