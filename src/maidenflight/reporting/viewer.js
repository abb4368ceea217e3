"use strict";
/* The flight viewer: one clock moves the drone in space and the cursors of the charts. */

const logs = embedded("logs");
const part = name => document.getElementById(name);
const view = part("scene");
const scene = new Scene(view, logs.arm, logs.rotors);
const viewer = {time: 0, playing: false, flight: 0, traces: []};
window.viewer = viewer;

/* Columns of numbers; see viewer.py. */
function unpacked({middle, step, rows}) {
  const levels = new Int16Array(Uint8Array.from(atob(rows), letter => letter.charCodeAt(0)).buffer), count = levels.length / middle.length;
  return middle.map((value, i) => Array.from(levels.subarray(i * count, (i + 1) * count), level => value + level * step[i]));
}

/* A flight with its columns, reference, position error [m], duration and range of error worked out, once. */
function prepared(number) {
  const flight = logs.flights[number];
  if (flight.error) return flight;
  const columns = unpacked(flight), reference = logs.references[flight.reference];
  const [measured, true_] = [columns.slice(0, 3), columns.slice(10)];
  Object.assign(flight, {measured, position: true_.length ? true_ : measured, hasTruth: true_.length > 0, attitude: columns.slice(3, 6), command: columns.slice(6, 10)});
  flight.hasReference = reference !== null;
  flight.reference = reference ? unpacked(reference) : flight.position;
  flight.rows = flight.position[0].length;
  flight.duration = flight.rows * flight.period;
  flight.error = flight.position[0].map((_, i) => Math.hypot(...flight.position.map((column, axis) => column[i] - flight.reference[axis][i])));
  flight.worst = flight.hasReference ? rounded(flight.error.reduce((most, value) => Math.max(most, value), 0.01)) : 1;
  return flight;
}

/* Pose and commands at a time: position and attitude between two rows, each command held until the next row. */
function at(flight, time) {
  const row = Math.min(flight.rows - 1, Math.floor(time / flight.period + 1e-6)), next = Math.min(flight.rows - 1, row + 1);
  const share = Math.min(1, Math.max(0, time / flight.period - row));
  const between = column => column[row] + share * (column[next] - column[row]);
  const turned = column => column[row] + share * Math.atan2(Math.sin(column[next] - column[row]), Math.cos(column[next] - column[row]));
  return {row, position: flight.position.map(between), attitude: flight.attitude.map(turned), command: flight.command.map(column => column[row])};
}

function traces(flight) {
  const line = (name, shade, values) => ({name, colour: shade, values, period: flight.period});
  const degrees = flight.attitude.map(column => column.map(value => (value * 180) / Math.PI));
  const steepest = rounded(degrees.flat().reduce((most, value) => Math.max(most, Math.abs(value)), 1));
  const seek = share => show(Math.min(1, Math.max(0, share)) * flight.duration);
  const error = {title: "Position error", unit: "cm", decimals: 2, low: 0, high: flight.worst * 100};
  const made = [
    ["attitude", {title: "Attitude", unit: "°", decimals: 1, low: -steepest, high: steepest,
      lines: ["roll", "pitch", "yaw"].map((name, i) => line(name, ["blue", "orange", "green"][i], degrees[i]))}],
    ["command", {title: "Motor commands", unit: "1: full thrust", decimals: 2, low: 0, high: 1, stacked: true,
      lines: flight.command.map((column, i) => line(String(i + 1), ["blue", "orange", "green", "purple"][i], column))}],
  ];
  if (flight.hasReference) made.unshift(["error", {...error, lines: [line("error", "blue", flight.error.map(value => value * 100))]}]);
  for (const name of ["error", "attitude", "command"]) part(`trace-${name}`).parentElement.hidden = !made.some(entry => entry[0] === name);
  return made.map(([name, plan]) => new Trace(part(`trace-${name}`), part(`legend-${name}`), plan, seek));
}

function choose(number) {
  const flight = prepared(number);
  viewer.flight = number;
  part("flight").value = number;
  part("time").max = flight.duration;
  scene.frame(flight);
  part("measured").parentElement.hidden = !flight.hasTruth;
  viewer.traces = traces(flight);
  for (const row of document.querySelectorAll("table.flights tbody tr")) row.classList.toggle("chosen", row.dataset.flight === String(flight.row));
  redraw();
}

/* Shows the flight of a place among all, where it is among those held. */
function choosePlace(place) {
  const number = logs.flights.findIndex(flight => flight.row === place);
  if (number < 0) return;
  choose(number);
  part("viewer").scrollIntoView({behavior: "smooth", block: "nearest"});
}

function redraw() {
  for (const trace of viewer.traces) trace.draw(prepared(viewer.flight).duration);
  show(Math.min(viewer.time, prepared(viewer.flight).duration));
}

function show(time) {
  const flight = prepared(viewer.flight);
  viewer.time = time;
  scene.draw(flight, time);
  for (const trace of viewer.traces) trace.mark(time, at(flight, time).row);
  part("time").value = time;
  part("time").setAttribute("aria-valuetext", `${time.toFixed(1)} seconds`);
  part("clock").value = `${time.toFixed(2)} s`;
  part("viewer").dataset.time = time.toFixed(3);
  part("viewer").dataset.position = at(flight, time).position.map(value => value.toFixed(4)).join(" ");
}

function play(on) {
  const flight = prepared(viewer.flight);
  if (on && viewer.time >= flight.duration - 1e-6) viewer.time = 0;
  viewer.playing = on;
  viewer.last = performance.now();
  part("play").textContent = on ? "Pause" : "Play";
  part("play").setAttribute("aria-pressed", on);
  if (on) requestAnimationFrame(tick);
}

function tick(now) {
  if (!viewer.playing) return;
  const { duration } = prepared(viewer.flight);
  const time = viewer.time + (Math.max(0, now - viewer.last) / 1000) * part("speed").value;
  viewer.last = now;
  show(Math.min(time, duration));
  if (time >= duration) play(false);
  else requestAnimationFrame(tick);
}

function turn(right, up) {
  scene.azimuth -= right;
  scene.elevation = Math.min(1.55, Math.max(-0.1, scene.elevation + up));
  show(viewer.time);
}

function zoom(by) {
  scene.zoom = Math.min(8, Math.max(0.4, scene.zoom * by));
  show(viewer.time);
}

function listenToView() {
  const fingers = new Map();
  const apart = () => { const [one, other] = [...fingers.values()]; return Math.hypot(one[0] - other[0], one[1] - other[1]); };
  view.onpointerdown = event => { view.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.clientX, event.clientY]); };
  view.onpointerup = view.onpointercancel = event => fingers.delete(event.pointerId);
  view.onpointermove = event => {
    if (!fingers.has(event.pointerId)) return;
    const [x, y] = fingers.get(event.pointerId), before = fingers.size === 2 ? apart() : 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (before) zoom(apart() / before);
    else turn((event.clientX - x) * 0.008, (event.clientY - y) * 0.008);
  };
  view.addEventListener("wheel", event => { // a page that scrolls past must not be caught here
    if (document.activeElement !== view && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
  }, {passive: false});
  const keys = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]};
  view.onkeydown = event => {
    if (keys[event.key]) turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.15 : 1 / 1.15);
    else return;
    event.preventDefault();
  };
}

function listen() {
  part("flight").onchange = event => choose(Number(event.target.value));
  part("measured").onchange = event => { scene.measured = event.target.checked; show(viewer.time); };
  part("time").oninput = event => { play(false); show(Number(event.target.value)); };
  part("play").onclick = () => play(!viewer.playing);
  document.addEventListener("keydown", event => {
    if (event.code !== "Space" || event.target.closest("button, select, summary, a, input:not([type=range])")) return;
    event.preventDefault();
    play(!viewer.playing);
  });
  const numbers = new Map(logs.flights.map((flight, number) => [String(flight.row), number]));
  for (const row of document.querySelectorAll("table.flights tbody tr")) {
    const number = numbers.get(row.dataset.flight);
    if (number !== undefined) row.onclick = () => choose(number);
  }
  listenToView();
  addEventListener("resize", redraw);
}

part("flight").append(...logs.flights.map((flight, number) => new Option(flight.label, number)));
listen();
choose(0);
inColours(redraw);
requestAnimationFrame(() => requestAnimationFrame(() => { part("viewer").dataset.drawn = Math.round(performance.now()); })); // the first frame is out [ms]
if (location.hash.slice(1).split("&").includes("autoplay")) part("play").click();
