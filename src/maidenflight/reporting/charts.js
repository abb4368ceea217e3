"use strict";
/* Charts by Vega-Lite: values under the pointer, zoom, legends that hide what they name, and files of them. */

const drawings = new Map(); // views by the figure's element

const made = (tag, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};

function sample(kind, shade) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), path = document.createElementNS(svg.namespaceURI, "path");
  const {path: drawn, width = 2, dash = [], fill = 0} = LOOK.samples[kind];
  svg.setAttribute("viewBox", "0 0 24 12");
  svg.setAttribute("class", "sample");
  path.setAttribute("d", drawn);
  Object.assign(path.style, {stroke: `var(--${shade})`, strokeWidth: width, strokeDasharray: dash.join(" "), fill: `var(--${shade})`, fillOpacity: fill});
  svg.append(path);
  return svg;
}

/* Rows of a table that is written in columns. */
function rowsOf({columns}) {
  const names = Object.keys(columns), [first = []] = Object.values(columns);
  return first.map((_, row) => Object.fromEntries(names.map(name => [name, columns[name][row]])));
}

/* A copy of a specification with its data in rows, {share: n, less: m} an nth of the width, less m pixels, and {wide, narrow} one of both. */
function laidOut(part, width, narrow) {
  if (Array.isArray(part)) return part.map(each => laidOut(each, width, narrow));
  if (part === null || typeof part !== "object") return part;
  if ("narrow" in part) return laidOut(width < narrow ? part.narrow : part.wide, width, narrow);
  if ("share" in part) return Math.max(24, Math.floor(width / part.share - part.less));
  if ("columns" in part) return {values: rowsOf(part)};
  return Object.fromEntries(Object.entries(part).map(([name, value]) => [name, laidOut(value, width, narrow)]));
}

const tip = document.body.appendChild(made("div", {id: "tip", hidden: true}));

/* The values of what the pointer is over, beside it. */
function tell(_, event, __, value) {
  tip.hidden = value === null || value === undefined || value === "";
  if (tip.hidden) return;
  const rows = Object.entries(value).filter(([, shown]) => shown !== "" && shown !== "null" && shown !== "NaN");
  tip.replaceChildren(...rows.map(([name, shown]) => made("div", {}, made("span", {textContent: name}), made("b", {textContent: shown}))));
  const {width, height} = tip.getBoundingClientRect(), edge = document.documentElement.clientWidth;
  tip.style.left = `${Math.max(4, Math.min(event.clientX + 14, edge - width - 8))}px`;
  tip.style.top = `${event.clientY + height + 24 > innerHeight ? event.clientY - height - 14 : event.clientY + 14}px`;
}

function drawPanel(plan, place, panel, hidden) {
  const spec = laidOut(panel, place.clientWidth, plan.narrow);
  const own = spec.vconcat ? {} : {width: "container", autosize: {type: "fit-x", contains: "padding"}};
  if (plan.series) Object.assign(own, {params: [{name: "hidden", value: []}], transform: [{filter: "indexof(hidden, datum.series) < 0"}]});
  const {spec: compiled} = vegaLite.compile({...own, ...spec, config: LOOK.config}, {logger: vega.logger(vega.Error)});
  const view = new vega.View(vega.parse(compiled, null, {ast: true}), {renderer: "svg", container: place, hover: true, expr: vega.expressionInterpreter});
  view.logLevel(vega.Error).tooltip(tell);
  if (plan.series) view.signal("hidden", [...hidden]);
  if (plan.chooses && typeof choosePlace === "function") view.addEventListener("click", (_, item) => item?.datum?.place >= 0 && choosePlace(item.datum.place));
  view.run();
  return view;
}

function drawFigure(figure) {
  if (drawings.has(figure)) return;
  const plan = JSON.parse(figure.querySelector("script").textContent), hidden = new Set(), views = [];
  drawings.set(figure, views);
  const panels = made("div", {className: "panels"});
  panels.style.gridTemplateColumns = plan.columns ? `repeat(${plan.columns}, minmax(${plan.least}px, 1fr))` : `repeat(auto-fit, minmax(min(100%, ${plan.least}px), 1fr))`;
  figure.querySelector("script").after(head(figure, plan, hidden, views), panels);
  const places = plan.panels.map(() => panels.appendChild(made("div", {className: "panel"})));
  for (const [number, panel] of plan.panels.entries()) views.push(drawPanel(plan, places[number], panel, hidden));
  let width = panels.clientWidth;
  figure.redrawn = () => { // only what depends on the width
    if (panels.clientWidth === width || !/"(share|narrow)"/.test(JSON.stringify(plan.panels))) return;
    width = panels.clientWidth;
    for (const [number, panel] of plan.panels.entries()) {
      views[number].finalize();
      views[number] = drawPanel(plan, places[number], panel, hidden);
    }
  };
}

/* Title, files and legend of a figure. */
function head(figure, plan, hidden, views) {
  const save = kind => made("button", {type: "button", className: "button", textContent: kind.toUpperCase(), onclick: () => saved(figure, plan, kind)});
  const entries = plan.legend.map(({name, series, colour: shade, sample: kind}) => {
    const shown = [sample(kind, shade), name];
    if (series === null) return made("span", {className: "entry"}, ...shown);
    const button = made("button", {type: "button", className: "entry", title: "Hide or show"}, ...shown);
    button.setAttribute("aria-pressed", "true");
    button.onclick = () => {
      if (!hidden.delete(series)) hidden.add(series);
      button.setAttribute("aria-pressed", String(!hidden.has(series)));
      for (const view of views) view.signal("hidden", [...hidden]).run();
    };
    return button;
  });
  return made("div", {className: "head"},
    made("div", {className: "bar"}, made("b", {textContent: plan.title}), made("span", {className: "files"}, save("svg"), save("png"))),
    made("div", {className: "legend"}, ...entries));
}

/* The whole figure as one SVG in the colours that it is shown in, as it stands on the page. */
function asSvg(figure, plan) {
  const edge = figure.getBoundingClientRect(), pad = 12, texts = [], shades = getComputedStyle(document.documentElement);
  const place = element => { const box = element.getBoundingClientRect(); return [box.left - edge.left + pad, box.top - edge.top + pad, box.width, box.height]; };
  const word = (text, x, y, weight, shade) => `<text x="${x}" y="${y}" font-size="13" font-weight="${weight}" fill="var(--${shade})">${escaped(text)}</text>`;
  const [titleX, titleY] = place(figure.querySelector(".bar b"));
  texts.push(word(plan.title, titleX, titleY + 16, 600, "ink"));
  for (const entry of figure.querySelectorAll(".entry")) {
    if (entry.getAttribute("aria-pressed") === "false") continue;
    const svg = entry.querySelector("svg"), [x, y] = place(svg), path = svg.querySelector("path").cloneNode();
    for (const name of ["stroke", "fill", "fill-opacity", "stroke-width", "stroke-dasharray"]) path.setAttribute(name, getComputedStyle(svg.querySelector("path"))[name]);
    texts.push(`<g transform="translate(${x} ${y})">${new XMLSerializer().serializeToString(path)}</g>`, word(entry.textContent, x + 30, y + 10, 400, "ink"));
  }
  for (const svg of figure.querySelectorAll(".panel svg")) {
    const [x, y, width, height] = place(svg), copy = svg.cloneNode(true);
    for (const [name, value] of Object.entries({x, y, width, height})) copy.setAttribute(name, value);
    texts.push(new XMLSerializer().serializeToString(copy));
  }
  const [, top, , high] = place(figure.querySelector(".panels")), width = Math.ceil(edge.width + 2 * pad), height = Math.ceil(top + high + pad);
  const text = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="system-ui, sans-serif">` +
    `<rect width="100%" height="100%" fill="var(--paper)"/>${texts.join("")}</svg>`;
  return {text: text.replace(/var\(--(\w+)\)/g, (_, name) => shades.getPropertyValue(`--${name}`).trim()), width, height};
}

const escaped = text => text.replace(/[&<>"]/g, letter => `&#${letter.charCodeAt(0)};`);

/* The figure as a data URL, an SVG or a PNG of twice the size. */
async function asFile(figure, plan, kind) {
  const {text, width, height} = asSvg(figure, plan), svg = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  if (kind === "svg") return svg;
  const image = new Image(), canvas = made("canvas", {width: 2 * width, height: 2 * height});
  image.src = svg;
  await image.decode();
  canvas.getContext("2d").drawImage(image, 0, 0, 2 * width, 2 * height);
  return canvas.toDataURL("image/png");
}

async function saved(figure, plan, kind) {
  made("a", {href: await asFile(figure, plan, kind), download: `${figure.id}.${kind}`}).click();
}

/* All figures are drawn, one after another so that the page answers; what is folded when it is opened, for print at once. */
const figures = [...document.querySelectorAll("figure.chart")];
const waiting = figures.filter(figure => !figure.closest("details:not([open])"));
function drawNext() {
  const figure = waiting.shift();
  if (!figure) return;
  drawFigure(figure);
  setTimeout(drawNext);
}
drawNext();
addEventListener("beforeprint", () => figures.forEach(drawFigure));
for (const folded of document.querySelectorAll("details")) folded.addEventListener("toggle", () => folded.open && folded.querySelectorAll("figure.chart").forEach(drawFigure));
let resized;
addEventListener("resize", () => { clearTimeout(resized); resized = setTimeout(() => figures.forEach(figure => figure.redrawn && figure.redrawn()), 150); });
addEventListener("scroll", () => { tip.hidden = true; }, {passive: true});
