"use strict";
/* Light and dark, and tables that can be sorted. */

const embedded = name => JSON.parse(document.getElementById(name).textContent);

const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const redrawn = [];

/* Calls draw now, and again whenever light, dark or print changes what the colours mean. */
function inColours(draw) {
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", draw);
  redrawn.push(draw);
  draw();
}

/* A page of a file may not be allowed to remember. */
const remembered = {
  get() { try { return localStorage.getItem("theme"); } catch { return null; } },
  set(theme) { try { localStorage.setItem("theme", theme); } catch {} },
};

function dress(theme) {
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  document.getElementById("theme").textContent = `Theme: ${theme}`;
  for (const draw of redrawn) draw();
}

function listenToTheme() {
  const button = document.getElementById("theme"), themes = ["auto", "light", "dark"];
  let theme = themes.includes(remembered.get()) ? remembered.get() : "auto";
  button.hidden = false;
  button.onclick = () => {
    theme = themes[(themes.indexOf(theme) + 1) % themes.length];
    remembered.set(theme);
    dress(theme);
  };
  dress(theme);
}

function sortBy(table, column) {
  const heads = [...table.querySelectorAll("thead th")];
  const place = heads.findIndex(head => head.firstChild.dataset.column === column);
  if (place < 0) return;
  const rising = heads[place].getAttribute("aria-sort") !== "ascending";
  heads.forEach(head => head.removeAttribute("aria-sort"));
  heads[place].setAttribute("aria-sort", rising ? "ascending" : "descending");
  const value = row => row.cells[place].dataset.value;
  const [body] = table.tBodies;
  const [known, unknown] = [true, false].map(filled => [...body.rows].filter(row => (value(row) !== "") === filled));
  const numeric = known.every(row => isFinite(value(row)));
  known.sort((one, other) => (numeric ? value(one) - value(other) : value(one).localeCompare(value(other), "en", {numeric: true})));
  body.append(...(rising ? known : known.reverse()), ...unknown); // what is not known stays at the end
}

/* The part of the page that is read is marked in the navigation, which stays at the top. */
function listenToScrolling() {
  const links = [...document.querySelectorAll("nav a")], parts = links.map(link => document.querySelector(link.hash));
  const bar = document.querySelector("nav");
  const mark = () => {
    bar.classList.toggle("stuck", bar.getBoundingClientRect().top <= 0);
    const now = parts.findLastIndex(part => part.getBoundingClientRect().top < 120);
    links.forEach((link, number) => (number === now ? link.setAttribute("aria-current", "true") : link.removeAttribute("aria-current")));
  };
  addEventListener("scroll", mark, {passive: true});
  mark();
}

for (const table of document.querySelectorAll("table.sortable")) {
  for (const button of table.querySelectorAll("thead button")) button.onclick = () => sortBy(table, button.dataset.column);
}
listenToTheme();
listenToScrolling();
for (const wish of location.hash.slice(1).split("&")) {
  const [verb, what = ""] = wish.split("="), [name, column] = what.split(".");
  if (verb === "sort") sortBy(document.querySelector(`table.${CSS.escape(name)}`), column);
  if (verb === "theme") dress(what);
}
