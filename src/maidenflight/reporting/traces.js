"use strict";
/* Charts over time with a cursor: small canvases that share the flight's clock. */

const FOOT = 18, EDGE = 34; // room for the labels of time and of values, pixels

/* A round number at or above a value. */
function rounded(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 3, 4, 5, 6, 8, 10].find(step => step * power >= value * 0.999) * power;
}

class Trace {
  /* lines: name, colour, values; stacked: each line in a lane of its own from 0 to 1. */
  constructor(element, legend, {title, unit, decimals, lines, low, high, stacked}, seek) {
    element.replaceChildren();
    this.canvas = element.appendChild(document.createElement("canvas"));
    this.cursor = element.appendChild(document.createElement("i"));
    Object.assign(this, {element, legend, title, unit, decimals, lines, low, high, stacked});
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${title} over time${unit ? `, in ${unit}` : ""}`);
    const point = event => (event.buttons || event.type === "pointerdown") && seek((event.offsetX - EDGE) / (this.canvas.clientWidth - EDGE));
    element.onpointerdown = element.onpointermove = point;
  }

  draw(duration) {
    const ratio = devicePixelRatio || 1, width = this.element.clientWidth, height = this.element.clientHeight, pen = this.canvas.getContext("2d");
    Object.assign(this, {duration, width});
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    pen.scale(ratio, ratio);
    Object.assign(pen, {font: "12px system-ui, sans-serif", textBaseline: "middle", lineWidth: 1});
    const tall = height - FOOT - 6, lane = this.stacked ? tall / this.lines.length : tall;
    const across = time => EDGE + (time / duration) * (width - EDGE - 1);
    const rule = (value, y) => {
      pen.fillStyle = colour(value === 0 ? "line" : "grid");
      pen.fillRect(EDGE, Math.round(y), width - EDGE, 1);
    };
    const word = (text, x, y, align, shade = "soft") => {
      Object.assign(pen, {fillStyle: colour(shade), textAlign: align});
      pen.fillText(text, x, y);
    };
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60].find(size => duration / size <= 6) || 300;
    for (let time = 0; time <= duration * 1.001; time += step) word(+time.toFixed(2), Math.min(across(time), width - 12), height - 7, "center");
    this.lines.forEach((line, number) => {
      const top = 6 + (this.stacked ? number * lane : 0), room = this.stacked ? lane - 10 : lane;
      const up = value => top + room * (1 - (value - this.low) / (this.high - this.low));
      if (this.stacked || !number) {
        const levels = this.stacked ? [this.low, this.high] : [this.low, (this.low + this.high) / 2, this.high];
        for (const value of levels) {
          rule(value, up(value));
          const inward = this.stacked ? (value === this.high ? 4 : -4) : 0; // clear of the next lane's
          word(String(+value.toFixed(1)).replace("-", "−"), EDGE - 8, up(value) + inward, "right");
        }
        if (this.stacked) word(line.name, 0, top + room / 2, "left", line.colour);
      }
      pen.beginPath();
      line.values.forEach((value, i) => pen.lineTo(across(i * line.period), up(value)));
      Object.assign(pen, {strokeStyle: colour(line.colour), lineWidth: this.stacked ? 0.9 : 1.3, lineJoin: "round"});
      pen.stroke();
    });
  }

  /* Moves the cursor, and writes the values under it into the legend. */
  mark(time, row) {
    this.cursor.style.left = `${EDGE + (time / this.duration) * (this.width - EDGE - 1)}px`;
    const shown = this.lines.map(line => {
      const value = line.values[Math.min(row, line.values.length - 1)].toFixed(this.decimals).replace("-", "−");
      return `<span style="color:var(--${line.colour})">${this.lines.length > 1 ? `${line.name} ` : ""}${value}</span>`;
    });
    this.legend.innerHTML = `<b>${this.title}${this.unit ? ` [${this.unit}]` : ""}</b> &nbsp;${shown.join(" &nbsp;")}`;
  }
}
