"use strict";
/* Charts in the page's colours, and the sortable table of flights. */

const embedded = name => {
  const element = document.getElementById(name);
  return element ? JSON.parse(element.textContent) : null;
};

const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/* Calls draw now, and again whenever light, dark or print changes what the colours mean. */
function inColours(draw) {
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", draw);
  draw();
}

/* A copy of a figure in which every "var(--name)" is the colour that it means now. */
function coloured(part) {
  if (typeof part === "string") return part.replace(/^var\(--(\w+)\)$/, (_, name) => colour(name));
  if (Array.isArray(part)) return part.map(coloured);
  if (part && typeof part === "object") return Object.fromEntries(Object.entries(part).map(([key, value]) => [key, coloured(value)]));
  return part;
}

function drawCharts() {
  for (const [name, figure] of Object.entries(embedded("charts") || {})) {
    const element = document.getElementById(name);
    if (!element) continue;
    const {data, layout} = fitted(coloured(figure), element);
    Plotly.react(element, data, layout, {displayModeBar: false});
  }
}

/* On a phone the legend and the colour bar take less room. */
function fitted({data, layout}, element) {
  layout.width = element.clientWidth;
  if (layout.width > 480) return {data, layout};
  for (const trace of data) if (trace.marker && trace.marker.colorbar) Object.assign(trace.marker.colorbar, {orientation: "h", y: -0.2, yanchor: "top"}, {title: {...trace.marker.colorbar.title, side: "bottom"}});
  return {data, layout};
}

function sortBy(column) {
  const heads = [...document.querySelectorAll(".flights thead th")];
  const place = heads.findIndex(head => head.firstChild.dataset.column === column);
  if (place < 0) return;
  const rising = heads[place].getAttribute("aria-sort") !== "ascending";
  heads.forEach(head => head.removeAttribute("aria-sort"));
  heads[place].setAttribute("aria-sort", rising ? "ascending" : "descending");
  const value = row => row.cells[place].dataset.value;
  const body = document.querySelector(".flights tbody");
  const [known, unknown] = [true, false].map(filled => [...body.rows].filter(row => (value(row) !== "") === filled));
  const numeric = known.every(row => isFinite(value(row)));
  known.sort((one, other) => (numeric ? value(one) - value(other) : value(one).localeCompare(value(other), "en", {numeric: true})));
  body.append(...(rising ? known : known.reverse()), ...unknown); // what is not known stays at the end
}

for (const button of document.querySelectorAll(".flights thead button")) button.onclick = () => sortBy(button.dataset.column);
if (window.Plotly) {
  inColours(drawCharts);
  addEventListener("resize", drawCharts);
}
for (const wish of location.hash.slice(1).split("&")) if (wish.startsWith("sort=")) sortBy(wish.slice(5));
