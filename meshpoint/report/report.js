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

  // On a narrow page the traces take the whole width, and each panel's legend lies above it.
  const narrow = matchMedia("(max-width: 600px)");
  const LEGEND = { row_px: 17, columns: 2, gap_px: 14 };

  function fit(layout, traces) {
    if (!narrow.matches) return;
    layout.margin = { ...layout.margin, l: Math.min(layout.margin.l, 120) * 0.68, r: 10 };
    layout.font = { ...layout.font, size: 10 };
    layout.xaxis.domain = [0, 1];
    stack(layout, traces);
    for (const [name, own] of Object.entries(layout)) {
      if (!name.startsWith("yaxis")) continue;
      const title = { ...own.title, standoff: 0, font: { size: 9 } };
      layout[name] = { ...own, title, ...(own.type === "category" ? {} : { nticks: 5 }) };
    }
  }

  // Panels as high as they were, one below the other, each with room for the rows of its legend.
  function stack(layout, traces) {
    const { margin } = layout;
    const whole_px = layout.height - margin.t - margin.b;
    const axes = Object.keys(layout).filter((name) => name.startsWith("yaxis"));
    const panels = axes.map((name) => {
      const legend = name.replace("yaxis", "legend");
      const own = traces.filter((trace) => trace.legend === legend && trace.showlegend !== false);
      const above_px = LEGEND.gap_px + LEGEND.row_px * Math.ceil(own.length / LEGEND.columns);
      return { name, legend, above_px, high_px: whole_px * (layout[name].domain[1] - layout[name].domain[0]) };
    });
    const total_px = panels.reduce((sum, panel) => sum + panel.above_px + panel.high_px, 0);
    let below_px = total_px;
    for (const { name, legend, above_px, high_px } of panels) {
      const top = (below_px - above_px) / total_px;
      below_px -= above_px + high_px;
      layout[name] = { ...layout[name], domain: [Math.max(0, below_px / total_px), top] };
      layout[legend] = {
        ...layout[legend], x: 0, y: top, yanchor: "bottom", orientation: "h", font: { size: 9 },
        entrywidth: 1 / LEGEND.columns, entrywidthmode: "fraction", bgcolor: "#fff",
      };
    }
    layout.height = total_px + margin.t + margin.b;
  }

  // The names of moments above the traces, each in the lowest row where it covers no other one and
  // inside the page.
  function nameMoments(layout, width_px) {
    const { xaxis, margin } = layout;
    const [from, to] = xaxis.range;
    const plot_px = (width_px - margin.l - margin.r) * (xaxis.domain[1] - xaxis.domain[0]);
    const most_px = width_px - margin.l;
    const rows = [];
    layout.annotations = layout.annotations.map((own) => {
      if (own.yref !== "paper" || own.y !== 1) return own;
      const half_px = 3.2 * own.text.length + 3;
      const at_px = ((own.x - from) / (to - from)) * plot_px;
      const middle_px = Math.min(Math.max(at_px, half_px - margin.l), most_px - half_px);
      const free = (row) => row.every((other) => Math.abs(other.middle_px - middle_px) > other.half_px + half_px);
      let level = rows.findIndex(free);
      if (level < 0) level = rows.push([]) - 1;
      rows[level].push({ middle_px, half_px });
      return { ...own, xanchor: "center", xshift: middle_px - at_px, yshift: 15 * level };
    });
    layout.margin = { ...margin, t: 8 + 15 * Math.max(1, rows.length) };
  }

  function draw(shift) {
    const layout = { ...data.common, annotations: shift.annotations };
    layout.shapes = data.common.shapes.concat(shift.shapes);
    for (const [name, own] of Object.entries(shift.axes)) {
      layout[name] = { ...data.common[name], ...own };
    }
    const own = structuredClone(layout);
    fit(own, shift.data);
    nameMoments(own, figure.clientWidth);
    const icons = narrow.matches ? { displayModeBar: false } : {};
    Plotly.react(figure, shift.data, own, { ...config, ...icons });
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
