"use strict";
/* The page of a run folder: forms start steps, and how far each is, is asked for again and again. */

const FAST = 700, SLOW = 2000; // milliseconds between two questions, while something runs and else
const touched = new WeakSet(), here = document.getElementById("logs-here"), drop = document.getElementById("drop"), choose = document.getElementById("choose");
const part = (section, name) => section.querySelector(`.${name}`), stepOf = name => document.querySelector(`section[data-verb="${CSS.escape(name)}"]`);

async function ask(address, options = {}) {
  try {
    const answer = await fetch(address, options), text = await answer.text();
    try { return JSON.parse(text); } catch { return answer.ok ? {} : {error: text}; }
  } catch { return {error: "The page's server does not answer. Start maidenflight app again."}; }
}

function filledOf(form) {
  const filled = {};
  for (const field of [...form.elements].filter(one => one.name)) {
    if (field.type !== "checkbox") filled[field.name] = field.type === "textarea" ? field.value.split("\n") : field.value;
    else if (field.closest(".choices")) (filled[field.name] ??= []).push(...(field.checked ? [field.value] : []));
    else filled[field.name] = field.checked;
  }
  return filled;
}

const unfold = field => { for (let one = field.closest("details"); one; one = one.parentElement.closest("details")) one.open = true; };

/* Says what is wrong, and marks the field that an error names. */
function complain(section, error = "") {
  const form = section.querySelector("form"), name = (/--([\w-]+)/.exec(error) ?? /'(\w+)'/.exec(error))?.[1].replaceAll("-", "_").toLowerCase();
  for (const field of form.querySelectorAll("[aria-invalid]")) field.removeAttribute("aria-invalid");
  part(section, "error").textContent = error;
  if (!name || !(form.elements[name] instanceof Element)) return;
  unfold(form.elements[name]);
  form.elements[name].setAttribute("aria-invalid", "true");
}

async function run(section) {
  const form = section.querySelector("form"), invalid = [...form.elements].find(field => field.willValidate && !field.validity.valid);
  complain(section);
  if (invalid) return unfold(invalid) || invalid.reportValidity();
  complain(section, (await ask(`run/${section.dataset.verb}`, {method: "POST", body: JSON.stringify(filledOf(form))})).error);
  await look();
}

/* Makes a frame as high as what it shows. */
function fit({target: frame}) {
  const body = frame.contentDocument.body;
  new ResizeObserver(() => { frame.style.height = `${Math.ceil(body.getBoundingClientRect().height)}px`; }).observe(body);
}

function show(frame, address, live = false) {
  if (frame.dataset.address === address) return;
  const renews = live && frame.dataset.live && frame.contentWindow.renew, whole = new URL(address, location.href).href;
  Object.assign(frame.dataset, {address, live: live ? "yes" : ""});
  frame.hidden = !address;
  if (renews) renews(whole);
  else if (address) frame.contentWindow.location.replace(whole);
}

function update(name, step) {
  const section = stepOf(name), job = part(section, "job"), runs = ["running", "stopping"].includes(step.state), fly = part(section, "fly");
  if (job.made !== step.html) {
    const focused = job.contains(document.activeElement) && document.activeElement.getAttribute("href");
    job.innerHTML = job.made = step.html;
    if (focused) job.querySelector(`[href="${CSS.escape(focused)}"]`)?.focus();
  }
  section.dataset.state = step.state;
  part(section, "state").textContent = step.state === "cancelled" ? "stopped" : step.state;
  for (const [button, hidden] of Object.entries({go: runs, cancel: !runs, resume: !step.resumes})) part(section, button).hidden = hidden;
  part(section, "cancel").disabled = step.state === "stopping";
  document.querySelector(`nav a[href="#${CSS.escape(name)}"]`)?.setAttribute("data-state", step.state);
  show(part(section, "shown"), step.view, step.live);
  if (fly) {
    Object.assign(fly, {hidden: !step.policy, disabled: step.flies, textContent: step.flies ? "Flying, behind the training …" : "Fly the policy as it is now"});
    show(part(section, "flight"), step.flight);
  }
  for (const [field, texts] of Object.entries(step.filled)) {
    const element = section.querySelector("form").elements[field], value = texts.join("\n");
    if (element instanceof Element && !touched.has(element) && element.value !== value) element.value = value;
  }
  return runs || (fly && step.flies);
}

let again, turns = 0;
async function look() {
  clearTimeout(again);
  const turn = ++turns, {steps = {}, logs, problem, error} = await ask("state");
  if (turn !== turns) return; // asked again since
  document.getElementById("problem").textContent = error ?? problem;
  const busy = Object.entries(steps).map(([name, step]) => update(name, step)).some(Boolean);
  if (logs !== undefined && here.made !== logs) here.innerHTML = here.made = logs;
  again = setTimeout(look, busy ? FAST : SLOW);
}

const change = async (address, method) => { const {error} = await ask(address, {method}); await look(); return error; };

/* Sends files one after the other, then checks them. */
async function send(files) {
  const upload = document.getElementById("upload"), wrong = [];
  for (const [number, file] of files.entries()) {
    upload.textContent = `${number + 1} of ${files.length}: ${file.name}, ${(file.size / 1e6).toFixed(1)} MB`;
    const {error} = await ask(`logs/${encodeURIComponent(file.name)}`, {method: "PUT", body: file});
    if (error) wrong.push(error);
  }
  upload.textContent = wrong.join(" ");
  if (wrong.length < files.length) await run(stepOf("log"));
}

choose.onchange = async () => { await send([...choose.files]); choose.value = ""; };
here.onclick = ({target}) => target.name && change(`logs/${encodeURIComponent(target.name)}`, "DELETE");
addEventListener("dragover", event => { event.preventDefault(); drop.classList.add("over"); });
addEventListener("dragleave", () => drop.classList.remove("over"));
addEventListener("drop", event => { event.preventDefault(); drop.classList.remove("over"); send([...event.dataTransfer.files]); });

for (const section of document.querySelectorAll("section.step")) {
  section.addEventListener("submit", event => { event.preventDefault(); run(section); });
  section.addEventListener("input", event => touched.add(event.target));
  part(section, "resume").onclick = async () => complain(section, await change(`resume/${section.dataset.verb}`, "POST"));
  part(section, "cancel").onclick = () => change(`cancel/${section.dataset.verb}`, "POST");
  for (const fly of section.querySelectorAll(".fly")) fly.onclick = async () => complain(section, await change("preview", "POST"));
  for (const frame of section.querySelectorAll("iframe")) frame.addEventListener("load", fit);
}
look();
