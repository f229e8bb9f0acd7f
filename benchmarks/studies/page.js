"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { responsive: true, displaylogo: false };
  for (const [id, figure] of Object.entries(data.figures)) {
    Plotly.newPlot(document.getElementById(id), figure.data, figure.layout, config);
  }
})();
