"use strict";
/* The drone in space: a perspective drawing on a canvas, world z up, metres. */

const TRAIL = 2.5; // seconds of path drawn strongly

function mixed(from, to, share) {
  const parts = [from, to].map(text => [1, 3, 5].map(i => parseInt(text.slice(i, i + 2), 16)));
  return `rgb(${parts[0].map((value, i) => Math.round(value + (parts[1][i] - value) * share)).join(",")})`;
}

/* Columns of a rotation matrix: where the body's x, y, z axes point, for intrinsic ZYX roll, pitch, yaw. */
function axes([roll, pitch, yaw]) {
  const [cr, cp, cy] = [roll, pitch, yaw].map(Math.cos), [sr, sp, sy] = [roll, pitch, yaw].map(Math.sin);
  return [
    [cy * cp, sy * cp, -sp],
    [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr],
    [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr],
  ];
}

class Scene {
  constructor(canvas, arm, rotors) { // rotors: places in units of the arm, x forward, y left
    Object.assign(this, {canvas, arm, rotors, azimuth: -1.05, elevation: 0.36, zoom: 1, target: [0, 0, 0], extent: 1});
    this.pen = canvas.getContext("2d");
  }

  /* Looks at a flight: all of it fits, above a grid on the ground or, for a flight high above it, on a level nearer to the path. */
  frame(flight) {
    const sides = [0, 1, 2].map(axis => {
      const values = [...flight.position[axis], ...flight.reference[axis]];
      return values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
    });
    const wide = Math.max(0.15, Math.hypot(...sides.map(([low, high]) => (high - low) / 2)));
    this.cell = [0.05, 0.1, 0.25, 0.5, 1, 2, 5].find(size => wide / size < 4) || 10;
    this.ground = sides[2][0] < 1.2 * wide ? Math.min(0, sides[2][0]) : this.cell * Math.floor((sides[2][0] - 0.6 * wide) / this.cell);
    const middle = this.ground + 0.6 * (sides[2][1] - this.ground);
    this.target = [(sides[0][0] + sides[0][1]) / 2, (sides[1][0] + sides[1][1]) / 2, middle];
    this.extent = Math.max(wide * 0.95, 0.85 * (sides[2][1] - this.ground));
  }

  /* [x, y, depth] on the canvas of a point in the world. */
  project(point) {
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    const [x, y, z] = point.map((value, axis) => value - this.target[axis]);
    const distance = 4 * this.extent, depth = Math.max(0.05 * distance, distance - (ce * (ca * x + sa * y) + se * z));
    const scale = (this.zoom * 0.46 * Math.min(this.width, this.height) * distance) / this.extent / depth;
    return [this.width / 2 + scale * (ca * y - sa * x), this.height / 2 - scale * (ce * z - se * (ca * x + sa * y)), depth];
  }

  line(points, style, width, dash = []) {
    const pen = this.pen;
    pen.beginPath();
    points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...this.project(point).slice(0, 2)));
    Object.assign(pen, {strokeStyle: style, lineWidth: width, lineCap: "round", lineJoin: "round"});
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  }

  draw(flight, time) {
    const ratio = devicePixelRatio || 1, box = this.canvas.getBoundingClientRect();
    this.width = box.width;
    this.height = box.height;
    if (this.canvas.width !== Math.round(box.width * ratio) || this.canvas.height !== Math.round(box.height * ratio)) {
      this.canvas.width = Math.round(box.width * ratio);
      this.canvas.height = Math.round(box.height * ratio);
    }
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
    this.colours = Object.fromEntries(["ink", "soft", "line", "grid", "paper", "blue", "orange", "green"].map(name => [name, colour(name)]));
    this.floor();
    const now = at(flight, time);
    this.paths(flight, now.row);
    this.line([now.position, [...now.position.slice(0, 2), this.ground]], this.colours.line, 1, [3, 4]);
    this.drone(now);
    this.legend(flight);
  }

  floor() {
    const size = this.cell, count = Math.ceil((1.3 * this.extent) / size), z = this.ground;
    const [x, y] = this.target.map(value => Math.round(value / size) * size);
    for (let i = -count; i <= count; i++) {
      this.line([[x + i * size, y - count * size, z], [x + i * size, y + count * size, z]], this.colours.line, 0.6);
      this.line([[x - count * size, y + i * size, z], [x + count * size, y + i * size, z]], this.colours.line, 0.6);
    }
    const corner = [x - count * size, y - count * size, z];
    ["x", "y", "z"].forEach((name, axis) => {
      const tip = corner.map((value, i) => value + (i === axis ? size : 0));
      this.line([corner, tip], this.colours.soft, 1.5);
      const [left, top] = this.project(corner.map((value, i) => value + (i === axis ? 1.25 * size : 0)));
      this.words(name, left, top, "center");
    });
  }

  words(text, x, y, align = "left") {
    Object.assign(this.pen, {font: "13px system-ui, sans-serif", fillStyle: this.colours.soft, textAlign: align, textBaseline: "middle"});
    this.pen.fillText(text, x, y);
  }

  paths(flight, row) {
    const points = flight.position[0].map((_, i) => flight.position.map(column => column[i]));
    if (flight.hasReference) this.line(flight.reference[0].map((_, i) => flight.reference.map(column => column[i])), this.colours.soft, 1.2);
    this.pen.globalAlpha = 0.3;
    this.line(points.slice(0, row + 1), this.colours.blue, 1);
    this.pen.globalAlpha = 1;
    if (this.measured && flight.hasTruth) {
      const from = Math.max(0, row - Math.round(TRAIL / flight.period)), seen = flight.measured[0].slice(from, row + 1);
      this.line(seen.map((_, i) => flight.measured.map(column => column[from + i])), this.colours.green, 1);
    }
    const first = Math.max(0, row - Math.round(TRAIL / flight.period));
    for (let i = first; i < row; i++) {
      const share = flight.hasReference ? Math.min(1, flight.error[i] / flight.worst) : 0;
      this.line([points[i], points[i + 1]], mixed(this.colours.blue, this.colours.orange, share), 3);
    }
  }

  /* Four arms with discs; bars on them stand for the motors' commands. */
  drone(now) {
    const [forward, left, up] = axes(now.attitude), near = this.project(now.position)[2];
    const pixels = (this.zoom * 0.46 * Math.min(this.width, this.height) * 4) / near; // per metre
    const reach = Math.max(1.8 * this.arm, 30 / pixels), place = (x, y, z) =>
      now.position.map((value, i) => value + reach * (x * forward[i] + y * left[i] + z * up[i]));
    this.line([...Array(13).keys()].map(i => [...place(Math.cos(i * 0.5236), Math.sin(i * 0.5236), 0).slice(0, 2), this.ground]), this.colours.line, 1);
    const hubs = this.rotors;
    hubs.forEach(([x, y]) => this.line([now.position, place(x, y, 0)], this.colours[x > 1e-3 ? "orange" : "ink"], 4));
    const order = hubs.map((hub, motor) => motor).sort((one, other) => this.project(place(...hubs[other], 0))[2] - this.project(place(...hubs[one], 0))[2]);
    for (const motor of order) {
      const [x, y] = hubs[motor];
      const ring = [...Array(25).keys()].map(i => place(x + 0.5 * Math.cos(i * 0.2618), y + 0.5 * Math.sin(i * 0.2618), 0.08));
      this.line(ring, this.colours.soft, 1.2);
      this.line([place(x, y, 0.08), place(x, y, 1.08)], this.colours.line, 5);
      this.line([place(x, y, 0.08), place(x, y, 0.08 + Math.max(0, now.command[motor]))], this.colours.green, 5);
    }
  }

  legend(flight) {
    this.words(flight.simulated ? `simulated, ${flight.hasTruth ? "true" : "measured"} position` : "real flight, measured position", 12, 18);
    this.words(`grid ${this.cell} m, at height ${+this.ground.toFixed(2)} m`, this.width - 12, this.width < 480 ? 38 : 18, "right");
    if (!flight.hasReference) return;
    const right = this.width - 12, top = this.height - 18, shade = this.pen.createLinearGradient(right - 130, 0, right - 50, 0);
    shade.addColorStop(0, this.colours.blue);
    shade.addColorStop(1, this.colours.orange);
    this.pen.fillStyle = shade;
    this.pen.fillRect(right - 130, top - 3, 80, 6);
    this.words("position error 0", right - 136, top, "right");
    this.words(`${Math.round(flight.worst * 100)} cm`, right - 44, top);
  }
}
