"use strict";
// Draws every figure of a campaign's report into the element of its name.
(() => {
  const figures = JSON.parse(document.getElementById("data").textContent);
  const bare = { responsive: true, displayModeBar: false };
  for (const [name, figure] of Object.entries(figures)) {
    Plotly.newPlot(document.getElementById(name), figure.data, figure.layout, bare);
  }
})();
