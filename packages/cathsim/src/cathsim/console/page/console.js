// The page: a websocket that brings pictures and takes controls, the two monitors, the gauges, the questionnaire.

import { Controls } from "/page/controls.js";
import { Space } from "/page/space.js";

const $ = (id) => document.getElementById(id);
const RECONNECT = 1500; // ms
const ANSWERED = "questionnaire answered"; // in this session of the browser
const LIMITS = [150, 300, 600, 1200]; // control steps
const RADII = [4, 6, 8, 10, 15]; // mm
const FORCES = [0.5, 1, 2, 3, 4]; // N
const STATES = { ready: "READY", running: "LIVE", ended: "ENDED", replay: "REPLAY" };
const PROMPTS = { ready: "Press ↑ to begin: the clock starts with the first touch", ended: "R: another one · P: replay" };
const decoder = new TextDecoder();
const token = new URLSearchParams(location.search).get("token") ?? "";

// What tests and the curious may read: pictures received and drawn, and the time from a key to its picture.
const statistics = (window.consoleStatistics = { received: 0, drawn: 0, latencies: [], frame: null, task: null, controls: [0, 0], notices: [] });
const sentAt = new Map(); // sequence -> when its key went down or up
let socket = null, sequence = 0, task = null, newest = null, drawing = false, refused = false;

let space = null;
try { space = new Space($("space")); } catch (error) { $("label-space").textContent = error.message; }
const screens = { a: $("fluoroscopy").getContext("2d"), b: $("second").getContext("2d") };

const controls = new Controls({ send: sendControls, tell, device: (name) => { $("device").textContent = name; } });

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function sendControls(axes) {
  const [advance, rotate, ...catheter] = axes, both = task?.devices === 2;
  const steered = both ? axes : [advance, rotate];
  if (steered.some((x, k) => x !== statistics.controls[k])) sentAt.set(++sequence, performance.now());
  statistics.controls = steered;
  send({ type: "controls", advance, rotate, sequence, ...(both ? { catheter } : {}) });
}

// -- the connection ---------------------------------------------------------------------------------------------------

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(`${scheme}//${location.host}/ws${token ? `?token=${encodeURIComponent(token)}` : ""}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { refused = false; hideNotice(); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : look(data));
  socket.onclose = ({ code, reason }) => {
    setState("", "NO SIGNAL");
    tell(reason || "No connection to the console: is it still running? Trying again …", "error", true);
    if (code === 4401 || code === 4429) { refused = code === 4401; return; }
    setTimeout(connect, RECONNECT);
  };
}

function hear(message) {
  if (message.type === "task") setTask(message);
  else if (message.type === "notice") tell(message.text, message.kind);
  else if (message.type === "loading") { setState("", "LOADING"); $("label-prompt").textContent = `building ${message.phantom} …`; }
  else if (message.type === "ended") showEnd(message);
  else if (message.type === "views") { task.views = message.views; markTargets(); }
  else if (message.type === "expert") showExpert(message.score);
  else if (message.type === "expert_progress") followExpert(message);
  else if (message.type === "saved") { sessionStorage.setItem(ANSWERED, "1"); tell(`Answers saved in ${message.path}`); }
  else if (message.type === "restarted") closeEnd();
}

function look(data) {
  const magic = decoder.decode(new Uint8Array(data, 0, 4));
  const bytes = new DataView(data);
  if (magic === "MESH") {
    const vertices = bytes.getUint32(4, true), faces = bytes.getUint32(8, true);
    space?.setSurface(
      new Float32Array(data, 12, 3 * vertices), new Float32Array(data, 12 + 12 * vertices, 3 * vertices),
      new Uint32Array(data, 12 + 24 * vertices, 3 * faces));
    return;
  }
  const length = bytes.getUint32(4, true);
  const frame = JSON.parse(decoder.decode(new Uint8Array(data, 8, length)));
  const inner = frame.points, outer = frame.catheter_points ?? 0;
  const flat = new Float32Array(data, 8 + length, 3 * (inner + outer));
  const points = Array.from({ length: inner + outer }, (_, k) => [flat[3 * k], flat[3 * k + 1], flat[3 * k + 2]]);
  frame.wire = points.slice(0, inner);
  frame.catheter = points.slice(inner);
  let from = 8 + length + 12 * (inner + outer);
  frame.pictures = frame.jpeg_bytes.map((size) => new Blob([new Uint8Array(data, (from += size) - size, size)], { type: "image/jpeg" }));
  statistics.received++;
  newest = frame;
  if (!drawing) draw();
}

// -- pictures and gauges ----------------------------------------------------------------------------------------------

async function draw() {
  drawing = true;
  while (newest) {
    const frame = newest;
    newest = null;
    try {
      for (const [k, screen] of [screens.a, screens.b].entries()) {
        if (screen.canvas.hidden) continue;
        const image = await createImageBitmap(frame.pictures[k]);
        screen.drawImage(image, 0, 0, screen.canvas.width, screen.canvas.height);
        image.close();
      }
    } catch { continue; }
    drawSpace(frame);
    gauges(frame);
    statistics.drawn++;
    statistics.frame = frame;
    for (const [number, at] of sentAt) {
      if (number > frame.sequence) break;
      if (number === frame.sequence && frame.state === "running") {
        statistics.latencies.push(performance.now() - at);
        if (statistics.latencies.length > 200) statistics.latencies.shift();
      }
      sentAt.delete(number);
    }
  }
  drawing = false;
}

// The fluoroscopy goes first: without a graphics card the 3-D view follows at half of the pictures, on a machine that
// does not keep up at a third; a wire that lies still is not drawn again.
let spaceShown = "", spaceAt = 0;
function drawSpace(frame) {
  const now = performance.now(), key = `${frame.state} ${frame.time_s}`;
  if (!space || $("space").hidden || (key === spaceShown && !space.changed)) return;
  if (now - spaceAt < (statistics.fps < 25 ? 95 : space.slow ? 60 : 0)) return;
  space.draw(frame.wire, frame.catheter);
  spaceShown = key;
  spaceAt = now;
}

function put(id, text) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
}

function gauges(frame) {
  setState(frame.state, STATES[frame.state]);
  put("force", frame.force_n.toFixed(2));
  const limit = task?.force_limit_n ?? 2, share = frame.force_n / limit; // the first picture may come before its task
  const level = share >= 1 ? "danger" : share >= 0.5 ? "warn" : "safe";
  $("force-bar").style.width = `${Math.min(100, 50 * share)}%`;
  $("force-peak").style.left = `${Math.min(99.5, (50 * frame.force_max_n) / limit)}%`;
  $("force-gauge").dataset.level = $("fluoroscopy-monitor").dataset.level = level;
  put("warnings", frame.force_warnings ? `${frame.force_warnings} warning${frame.force_warnings > 1 ? "s" : ""}` : "");
  put("time", frame.time_s.toFixed(1));
  put("distance", frame.distance_mm.toFixed(0));
  put("insertion", frame.insertion_mm.toFixed(0));
  put("rotation", degrees(frame.rotation_rad));
  if (frame.lead_mm !== undefined) deviceGauge(frame);
  monitorGauge(frame);
  put("label-prompt", PROMPTS[frame.state] ?? "");
  put("dose", frame.dose_s.toFixed(1));
  put("injections", frame.injections);
  put("label-beam", frame.beam ? `☢ X-RAY ${frame.dose_s.toFixed(1)} s` : "LAST IMAGE HELD");
  $("label-beam").dataset.on = frame.beam;
  $("pedal").classList.toggle("held", frame.beam);
  $("roadmap").classList.toggle("held", frame.roadmap);
  $("inject").classList.toggle("held", frame.contrast > 0);
  $("recording").hidden = !(task?.recording && frame.state === "running");
}

const degrees = (angle) => (Math.round((angle * 180) / Math.PI) + 0).toFixed(0);
const signed = (x) => x.toFixed(2).replace(/^-(0\.00)$/, "$1").replace("-", "−");

function deviceGauge(frame) {
  const [wire, catheter] = frame.feeder_forces_n;
  const lead = Math.round(frame.lead_mm);
  put("lead", lead < 0 ? `wire drawn back by ${-lead} mm` : `wire ahead by ${lead} mm`);
  put("wire-insertion", `${frame.insertion_mm.toFixed(0)} mm`);
  put("wire-rotation", `${degrees(frame.rotation_rad)}°`);
  put("wire-push", `${signed(wire)} N`);
  put("catheter-insertion", `${frame.catheter_insertion_mm.toFixed(0)} mm`);
  put("catheter-rotation", `${degrees(frame.catheter_rotation_rad)}°`);
  put("catheter-push", `${signed(catheter)} N`);
}

// Where the gauges are below the edge of a small screen, the monitor says the same.
function monitorGauge(frame) {
  const shown = frame.state === "running" || frame.state === "replay", rows = [];
  if (frame.lead_mm !== undefined) {
    for (const name of ["catheter", "wire"]) rows.push(`${name} ${["insertion", "rotation", "push"].map((what) => $(`${name}-${what}`).textContent).join(", ")}`);
    rows.push($("lead").textContent);
  } else rows.push(`wire ${frame.insertion_mm.toFixed(0)} mm, ${degrees(frame.rotation_rad)}°`);
  rows.push(`wall ${frame.force_n.toFixed(2)} N${frame.force_warnings ? `, ${$("warnings").textContent}` : ""}`);
  rows.push(`${frame.distance_mm.toFixed(0)} mm to go · ${frame.time_s.toFixed(1)} of ${$("limit").textContent} s`);
  put("label-devices", shown ? rows.join("\n") : "");
}

function setState(state, label) {
  const element = $("label-state");
  if (element.dataset.state !== state) element.dataset.state = state;
  put("label-state", label);
}

function setTask(message) {
  expertFailed = false;
  expertProgress = null;
  put("expert", "");
  task = statistics.task = message;
  choices($("phantom"), message.phantoms, message.phantom);
  choices($("target"), message.targets, message.target);
  const catheters = message.catheters.map(({ name, shape, french }) => new Option(french ? `${shape} ${french}F` : shape, name));
  $("catheter").replaceChildren(new Option("none", ""), ...catheters);
  $("catheter").value = message.catheter ?? "";
  choices($("wire"), message.wires, message.wire);
  amounts($("limit-choice"), LIMITS, message.max_steps, (steps) => `${+(steps * message.control_step).toFixed(1)} s`);
  amounts($("radius-choice"), RADII, message.success_radius_mm, (radius) => `${radius} mm`);
  amounts($("force-choice"), FORCES, message.force_limit_n, (force) => `${force} N`);
  $("force-ends").value = message.ends_at_force_limit ? "ends" : "";
  put("force-limit", `${message.ends_at_force_limit ? "ends" : "warns"} at ${message.force_limit_n}`);
  put("force-scale", `${2 * message.force_limit_n} N`);
  const device = message.catheter ? ` · ${$("catheter").selectedOptions[0].text.toUpperCase()}` : "";
  put("label-task", `${message.phantom.replaceAll("_", " ").toUpperCase()} → ${message.target.toUpperCase()}${device}`);
  document.body.dataset.devices = message.devices;
  controls.steer(message.devices);
  put("limit", (message.max_steps * message.control_step).toFixed(0));
  for (const { canvas } of Object.values(screens)) canvas.width = canvas.height = message.size;
  space?.setTask(message);
  $("replay").disabled = !message.replayable;
  fillQuestions(message.criteria);
  closeEnd();
  markTargets();
}

const words = (name) => (name.length < 5 ? name.toUpperCase() : name.replaceAll("_", " "));

function choices(select, names, chosen) {
  select.replaceChildren(...names.map((name) => new Option(words(name), name, false, name === chosen)));
}

// What is offered, and the chosen one among it.
function amounts(select, offered, chosen, text) {
  const all = [...new Set([...offered, chosen])].sort((x, y) => x - y);
  select.replaceChildren(...all.map((value) => new Option(text(value), value, false, value === chosen)));
}

// The ring of the target lies on a canvas of its own, sharp at any size of the monitor; the bright corners are shaded, as
// a collimator would.
function markTargets() {
  markTarget($("overlay"), "a");
  markTarget($("second-overlay"), "b");
}

function markTarget(canvas, camera) {
  const ratio = devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!task || canvas.hidden) return;
  const { mark, primary_deg: primary, secondary_deg: secondary, zoom } = task.views[camera];
  put(`angles-${camera}`, $("space").hidden || camera === "a" ? `${angleWords(primary, secondary)}${zoom > 1 ? ` · ${zoom.toFixed(1)}×` : ""}` : "3-D");
  if (camera === "a") for (const id of ["side-left", "side-right"]) $(id).hidden = Math.abs(primary) > 45;
  const scale = Math.min(canvas.width, canvas.height) / task.size;
  const left = (canvas.width - scale * task.size) / 2, top = (canvas.height - scale * task.size) / 2;
  const middle = [canvas.width / 2, canvas.height / 2], side = scale * task.size;
  const shade = pen.createRadialGradient(...middle, 0.34 * side, ...middle, 0.74 * side);
  shade.addColorStop(0, "#0000");
  shade.addColorStop(0.35, "#0007");
  shade.addColorStop(1, "#000f");
  pen.fillStyle = shade;
  pen.fillRect(left - 2, top - 2, side + 4, side + 4);
  const [u, v] = mark.pixel.map((x, k) => [left, top][k] + (x + 0.5) * scale);
  const radius = mark.radius * scale;
  pen.strokeStyle = "#2fe08a";
  pen.lineWidth = 1.6 * ratio;
  pen.setLineDash([5 * ratio, 4 * ratio]);
  pen.beginPath();
  pen.arc(u, v, radius, 0, 2 * Math.PI);
  pen.stroke();
  pen.font = `600 ${12 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
  pen.textBaseline = "middle";
  pen.lineWidth = 3 * ratio;
  pen.setLineDash([]);
  pen.strokeStyle = "#000c";
  pen.strokeText(task.target.toUpperCase(), u + radius + 6 * ratio, v);
  pen.fillStyle = "#5cf0ab";
  pen.fillText(task.target.toUpperCase(), u + radius + 6 * ratio, v);
}
for (const id of ["overlay", "second-overlay"]) new ResizeObserver(markTargets).observe($(id));

const angleWords = (primary, secondary) => {
  const side = Math.round(primary), tilt = Math.round(secondary);
  return `${side ? `${side > 0 ? "LAO" : "RAO"} ${Math.abs(side)}°` : tilt ? "" : "FRONTAL"}${tilt ? ` ${tilt > 0 ? "CRAN" : "CAUD"} ${Math.abs(tilt)}°` : ""}`.trim();
};

// -- the C-arms, pedal, contrast medium, roadmap ----------------------------------------------------------------------

// Dragging turns a C-arm about its patient, the wheel or two fingers zoom, a double click goes back.
const FIRST = { a: [0, 0, 1], b: [90, 0, 1] };
function turnable(canvas, camera) {
  const fingers = new Map();
  let wanted = null, sent = 0, spread = 0;
  const current = () => wanted ?? [task.views[camera].primary_deg, task.views[camera].secondary_deg, task.views[camera].zoom];
  const within = (x, low, high) => Math.max(low, Math.min(high, x));
  const ask = (primary, secondary, zoom) => {
    wanted = [within(primary, -120, 120), within(secondary, -50, 50), within(zoom, 1, 4)];
    put(`angles-${camera}`, `${angleWords(wanted[0], wanted[1])} · ${wanted[2].toFixed(1)}×`);
    if (!sent) sent = setTimeout(() => { // the loop builds a view in a third of a second
      sent = 0;
      send({ type: "view", camera, primary_deg: wanted[0], secondary_deg: wanted[1], zoom: wanted[2] });
    }, 150);
  };
  canvas.addEventListener("pointerdown", (event) => { fingers.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture?.(event.pointerId); spread = 0; });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => { fingers.delete(event.pointerId); spread = 0; });
  canvas.addEventListener("pointermove", (event) => {
    const from = fingers.get(event.pointerId);
    if (!from || !task) return;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const [primary, secondary, zoom] = current();
    if (fingers.size === 2) {
      const [p, q] = [...fingers.values()], now = Math.hypot(p[0] - q[0], p[1] - q[1]);
      if (spread) ask(primary, secondary, (zoom * now) / spread);
      spread = now;
    } else ask(primary + (event.clientX - from[0]) * 0.4, secondary + (event.clientY - from[1]) * 0.25, zoom);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const [primary, secondary, zoom] = current();
    ask(primary, secondary, zoom * Math.exp(-event.deltaY * 0.001));
  }, { passive: false });
  canvas.addEventListener("dblclick", () => ask(...FIRST[camera]));
  return () => { wanted = null; }; // the console's word counts again
}
const coarse = matchMedia("(pointer: coarse)");
const hint = () => put("hint-b", coarse.matches ? "drag sideways to turn, two fingers zoom" : "drag to turn, wheel to zoom");
coarse.addEventListener("change", hint);
hint();
turnable($("fluoroscopy"), "a");
turnable($("second"), "b");

const pedal = { kept: true, held: false };
function press() { send({ type: "pedal", on: pedal.kept || pedal.held }); }
function keepPedal() { pedal.kept = !(statistics.frame?.beam ?? true); press(); }
function inject() { send({ type: "inject" }); }
function roadmap() { send({ type: "roadmap", on: !statistics.frame?.roadmap }); }
for (const [id, act] of [["pedal", keepPedal], ["inject", inject], ["roadmap", roadmap]]) {
  $(id).addEventListener("click", () => { act(); $(id).blur(); });
}
addEventListener("keydown", (event) => spaceBar(event, true));
addEventListener("keyup", (event) => spaceBar(event, false));
function spaceBar(event, down) {
  if (event.code !== "Space" || !controls.enabled || event.target.closest?.("select, input, summary, dialog")) return;
  event.preventDefault();
  if (event.repeat) return;
  pedal.held = down;
  press();
}
addEventListener("blur", () => { if (pedal.held) { pedal.held = false; press(); } });

$("swap").addEventListener("click", () => {
  const inSpace = $("space").hidden && space;
  $("space").hidden = !inSpace;
  $("second").hidden = $("second-overlay").hidden = Boolean(inSpace);
  $("swap").textContent = inSpace ? "X-ray" : "3-D";
  $("swap").blur();
  if (space) space.changed = true;
  markTargets();
});

let before = { drawn: 0, at: performance.now() };
setInterval(() => {
  const now = performance.now();
  statistics.fps = ((statistics.drawn - before.drawn) * 1000) / (now - before.at);
  before = { drawn: statistics.drawn, at: now };
  const recent = statistics.latencies.slice(-20).sort((a, b) => a - b);
  const latency = recent.length ? ` · key to picture ${recent[recent.length >> 1].toFixed(0)} ms` : "";
  put("rate", `${statistics.fps.toFixed(0)} fps${latency}`);
}, 1000);

// -- choices, restart, replay -----------------------------------------------------------------------------------------

for (const id of ["phantom", "target", "catheter", "wire", "limit-choice", "radius-choice", "force-choice", "force-ends"]) {
  $(id).addEventListener("change", () => {
    controls.release();
    send({
      type: "choose", phantom: $("phantom").value, target: $("target").value, catheter: $("catheter").value || null,
      wire: $("wire").value, max_steps: Number($("limit-choice").value), success_radius_mm: Number($("radius-choice").value),
      force_limit_n: Number($("force-choice").value), ends_at_force_limit: $("force-ends").value === "ends",
    });
    $(id).blur(); // the keys steer the devices again
  });
}
$("restart").addEventListener("click", restart);
$("replay").addEventListener("click", replay);
addEventListener("keydown", (event) => {
  if (!controls.enabled || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.closest?.("select, input")) return;
  if (event.code === "KeyR") restart();
  if (event.code === "KeyP" && !$("replay").disabled) replay();
  if (event.code === "KeyF") keepPedal();
  if (event.code === "KeyC") inject();
  if (event.code === "KeyM") roadmap();
});

function restart() { send({ type: "restart" }); document.activeElement?.blur(); }
function replay() { send({ type: "replay" }); document.activeElement?.blur(); }

// -- the end of a procedure and the questionnaire ---------------------------------------------------------------------

function fillQuestions(criteria) {
  $("criteria").replaceChildren(...criteria.map(({ key, title, question }) => {
    const row = document.createElement("div");
    row.className = "criterion";
    row.innerHTML = "<p><b></b><span></span></p><div class=likert role=radiogroup></div>";
    row.querySelector("b").textContent = title;
    row.querySelector("span").textContent = question;
    const scale = row.querySelector(".likert");
    scale.setAttribute("aria-label", title);
    for (let value = 1; value <= 5; value++) {
      const label = document.createElement("label");
      label.innerHTML = `<input type=radio><i>${value}</i>`;
      Object.assign(label.firstChild, { name: key, value, ariaLabel: `${title}: ${value}` });
      scale.append(label);
    }
    return row;
  }));
}

function answers() {
  const form = new FormData($("questionnaire")), result = {};
  for (const { key } of task.criteria) if (form.has(key)) result[key] = Number(form.get(key));
  return result;
}

$("questionnaire").addEventListener("input", () => {
  $("save-answers").disabled = Object.keys(answers()).length < task.criteria.length;
});

const scoreRows = ({ time_s: time, metrics }) => ({
  time: `${time.toFixed(1)} s`,
  ...(metrics && {
    "mean force": `${metrics.force_mean.toFixed(2)} N`, "peak force": `${metrics.force_max.toFixed(2)} N`,
    "steps below 2 N": `${(100 * metrics.safety).toFixed(0)} %`, "way of the tip": `${(100 * metrics.path_length).toFixed(1)} cm`,
    ...(metrics.branch && { "tip ended": `${metrics.branch}, ${(1000 * metrics.depth).toFixed(0)} mm deep` }),
  }),
});

// The numbers of the operator, and those of the sampling expert in the same task once they are there.
let ended = null;
function fillNumbers() {
  const { expert, compared } = ended, own = {
    ...scoreRows(ended), "force warnings": `${ended.force_warnings}`, "X-ray": `${ended.dose_s.toFixed(1)} s`, contrast: `${ended.injections}×`,
  };
  const other = expert ? scoreRows(expert) : {};
  const cells = (kind, texts) => texts.map((text) => Object.assign(document.createElement(kind), { textContent: text }));
  const line = (...items) => { const row = document.createElement("tr"); row.append(...items); return row; };
  const head = compared ? [line(...cells("th", ["", "you", expertWords(expert)]))] : [];
  $("end-numbers").replaceChildren(...head, ...Object.entries(own).map(([name, value]) =>
    line(...cells("th", [name]), ...cells("td", compared ? [value, other[name] ?? "–"] : [value]))));
}

let expertFailed = false, expertProgress = null;
function expertWords(score) {
  if (score) return score.success ? "expert" : score.gave_up ? "expert (gave up)" : "expert (missed)";
  if (expertFailed) return "expert (failed)";
  return expertProgress ? `expert … ${(expertProgress.steps * task.control_step).toFixed(1)} s` : "expert …";
}
function followExpert(progress) {
  statistics.expertProgress = expertProgress = progress;
  const { steps, seconds } = progress;
  put("expert", `expert at ${(steps * task.control_step).toFixed(1)} s, computed for ${seconds.toFixed(0)} s`);
  if (ended) fillNumbers();
}
function showExpert(score) {
  statistics.expert = score;
  expertFailed = score === null;
  expertProgress = null;
  put("expert", score ? `expert ${score.time_s.toFixed(1)} s` : "");
  if (ended) { ended.expert = score; fillNumbers(); }
}

function showEnd(message) {
  const { success, invalid, stopped, recorded, trouble } = message;
  ended = message;
  controls.enable(false);
  $("replay").disabled = false;
  const dialog = $("end");
  pressedInside = false;
  dialog.dataset.success = success;
  $("end-title").textContent = success ? `${task.target.toUpperCase()} reached` : invalid ? "The simulation failed"
    : stopped ? `Force limit of ${task.force_limit_n} N reached` : "Time is up";
  fillNumbers();
  $("end-recorded").textContent = trouble || (recorded ? `Recorded in ${recorded}` : "Not recorded");
  const asked = recorded && !sessionStorage.getItem(ANSWERED); // once a session
  $("questions").hidden = !asked;
  $("save-answers").hidden = !asked;
  for (const input of document.querySelectorAll("#criteria input")) input.checked = false;
  $("save-answers").disabled = true;
  if (!dialog.open) dialog.showModal();
  $("again").focus({ preventScroll: true, focusVisible: true });
  dialog.scrollTop = 0; // the score first
}

function closeEnd() {
  controls.enable(true);
  if ($("end").open) $("end").close("closed");
  ended = null;
}

// A finger that still steers when the dialog opens over it is lifted above a question: that answers nothing.
let pressedInside = false;
$("end").addEventListener("pointerdown", () => { pressedInside = true; }, true);
$("end").addEventListener("click", (event) => {
  if (pressedInside || !event.detail) return; // a key or a script has no detail
  event.preventDefault();
  event.stopPropagation();
}, true);

$("end").addEventListener("close", () => {
  const wish = $("end").returnValue || "again"; // Escape leaves it empty
  $("end").returnValue = "";
  controls.enable(true);
  if (wish === "save") send({ type: "answers", answers: { ...answers(), participant: $("participant").value.trim() } });
  if (wish === "replay") replay();
  if (wish === "again") restart();
});

// -- notices ----------------------------------------------------------------------------------------------------------

let noticeTimer = 0;
function tell(text, kind = "info", stay = false) {
  statistics.notices.push(text);
  const notice = $("notice");
  notice.textContent = text;
  notice.dataset.kind = kind;
  notice.hidden = false;
  clearTimeout(noticeTimer);
  if (!stay) noticeTimer = setTimeout(hideNotice, 6000);
}
function hideNotice() { $("notice").hidden = true; }

connect();
