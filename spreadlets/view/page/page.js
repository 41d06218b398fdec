"use strict";
// The page: settings go to the server, pictures come back. Only the newest request counts.

const TOKEN = new URLSearchParams(location.search).get("token");
const $ = (id) => document.getElementById(id);
const settings = {};            // What is chosen, by the server's names.
const images = {};              // pinhole, reference, result: canvases.
const keys = new Map();         // Focus by frame.
const INFINITE = 1e9;           // The focus on the sky; a slider that reached there could not be set to anything near.
const view = { zoom: 0, x: 0, y: 0 };  // 0: the whole picture.
let hello = null, initial = null, socket = null, kernel = "";
let asked = 0;
window.pictures = [];           // Numbers and times of the pictures that came.

// --- The connection ---------------------------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(TOKEN)}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => receive(event.data);
  socket.onclose = lost;
}

function lost() { say("the program has ended, or the connection is lost: reload the page", true); }

function tell(message) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  else if (socket.readyState !== WebSocket.CONNECTING) lost();
}

function receive(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const message = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const bytes = buffer.byteLength > 4 + length ? new Uint8ClampedArray(buffer, 4 + length) : null;
  handlers[message.type](message, bytes);
}

const handlers = {
  hello(message) {
    hello = message;
    initial = { ...message.settings };
    $("names").textContent = message.names.join(", ");
    document.title = `${message.names[0] ?? "frame"} - spreadlets`;
    for (const option of $("against").options) option.disabled = option.value !== "pinhole" && !message.reference;
    if (message.reference) $("against").value = "reference";
    setRanges();
    reset();
  },
  pinhole(message, bytes) { images.pinhole = canvasOf(message, bytes); draw(); },
  reference(message, bytes) { images.reference = canvasOf(message, bytes); draw(); },
  picture(message, bytes) {
    images.result = canvasOf(message, bytes, images.result);
    window.pictures.push({ number: message.number, full: message.full, share: message.share, at: performance.now() });
    $("command-line").value = message.command;
    draw();
    report(message);
  },
  progress(message) {
    $("progress").hidden = false;
    $("progress").max = message.total;
    $("progress").value = message.done;
    say(`building the aperture: ${message.done} of ${message.total}`);
  },
  focus(message) {
    if (message.keep) {
      const range = [settings.near, settings.far || 0].filter((each) => each > 0);
      const all = [...(range.length ? range : [settings.focus]), message.focus];
      set("near", Math.min(...all));
      set("far", Math.max(...all));
    } else {
      set("near", 0);
      set("far", 0);
    }
    set("focus", message.focus);
    ask(false);
  },
  probe(message) {
    const number = (value) => (value === null ? "-" : Math.abs(value) < 1e-4 ? "0" : value.toPrecision(4));
    const colour = message.colour ? message.colour.map(number).join(" ") : "-";
    $("probe").textContent =
      `${message.x}, ${message.y}   RGB ${colour}   depth ${message.depth === null ? "background" : number(message.depth) + " m"}` +
      `   CoC ${number(message.coc)} px   motion ${message.motion.map(number).join(", ")} px`;
  },
  metrics(message) {
    $("metrics").textContent = `SSIM ${message.ssim.toFixed(4)}  FLIP ${message.flip?.toFixed(4) ?? "-"}  PSNR ${message.psnr?.toFixed(2) ?? "-"} dB`;
  },
  error(message) { say(message.text, true); },
};

function canvasOf(message, bytes, old) {
  const canvas = old && old.width === message.width && old.height === message.height ? old : document.createElement("canvas");
  canvas.width = message.width;
  canvas.height = message.height;
  canvas.getContext("2d").putImageData(new ImageData(bytes, message.width, message.height), 0, 0);
  return canvas;
}

// --- Requests ---------------------------------------------------------------------------------------------------

// What is asked for is sent at once: of all that wait, the server renders the newest only.
function ask(dragging) {
  asked += 1;
  $("progress").hidden = true;
  if (!dragging) say(`rendering ${asked}`);
  tell({ type: "render", number: asked, settings: { ...settings, kernel }, dragging, judging: isJudging() });
}

// What is at an address; nothing, and the reason is shown, if it cannot be had.
async function fetched(address, options) {
  try {
    const answer = await fetch(`${address}?token=${TOKEN}`, options);
    if (answer.ok) return answer;
    say(await answer.text(), true);
  } catch { lost(); }
  return null;
}

function isJudging() { return Number($("wipe").value) > 0 && $("against").value !== "pinhole"; }

function say(text, wrong = false) {
  $("status").textContent = text;
  $("status").classList.toggle("wrong", wrong);
}

const counted = (number, what) => `${number} ${what}${number === 1 ? "" : "s"}`;

function leftOut(message) { return message.plan.left_out?.length ? `, left out: ${message.plan.left_out.join(", ")}` : ""; }

function report(message) {
  const time = Object.entries(message.time_s).filter(([name, value]) => value > 0.0005 && name !== "total")
    .map(([name, value]) => `${name} ${(1000 * value).toFixed(0)}`).join(", ");
  const total = (1000 * message.time_s.total).toFixed(0);
  if (!message.full) {
    say(`drag ${message.number}: ${message.width} x ${message.height} px  ${total} ms (${time})${leftOut(message)}`);
    return;
  }
  $("progress").hidden = true;
  say(message.number === asked ? `ready ${message.number}: ${total} ms (${time}), ${counted(message.plan.layers, "layer")}${leftOut(message)}` : `rendering ${asked}`);
}

// --- Settings ---------------------------------------------------------------------------------------------------

const inputs = [...document.querySelectorAll("[data-setting]")];
const inputOf = Object.fromEntries(inputs.map((input) => [input.dataset.setting, input]));
const fieldOf = (input) => input.type === "range" ? input.parentElement.querySelector("input[type=number]") : null;
const short = (value) => String(Number(Number(value).toPrecision(5)));

function setRanges() {
  const range = (name, low, high) => { inputOf[name].min = low; inputOf[name].max = high; };
  const { f_number, focal_length, focus } = initial;
  range("f_number", f_number / 8, f_number * 8);
  range("focal_length", focal_length / 3, focal_length * 3);
  range("focus", Math.min(hello.nearest * 0.8, focus), Math.max(hello.farthest * 1.2, focus));
}

function set(name, value) {
  settings[name] = value;
  const input = inputOf[name];
  if (!input) return;
  if (input.type === "range" && Number(input.max) < value && value < INFINITE) input.max = value;
  if (input.type === "range" && Number(input.min) > value) input.min = value;
  input.value = typeof value === "number" && input.type !== "range" ? short(value) : value;
  const field = fieldOf(input);
  if (field) field.value = short(value);
}

function reset() {
  kernel = "";
  $("kernel").value = "";
  for (const [name, value] of Object.entries(initial)) if (name !== "kernel") set(name, value);
  ask(false);
}

for (const input of inputs) {
  const read = () => (input.tagName === "SELECT" ? input.value : Number(input.value));
  const take = (dragging) => {
    if (input.value === "") return;
    settings[input.dataset.setting] = read();
    const field = fieldOf(input);
    if (field) field.value = short(input.value);
    ask(dragging);
  };
  // A new aperture is built when it is chosen, not while it is dragged.
  input.addEventListener("input", () => { if (input.type === "range" && !("whole" in input.dataset)) take(true); });
  input.addEventListener("change", () => take(false));
  fieldOf(input)?.addEventListener("change", (event) => { if (event.target.value !== "") { set(input.dataset.setting, Number(event.target.value)); ask(false); } });
}

$("kernel").addEventListener("change", async () => {
  const file = $("kernel").files[0];
  if (!file) return;
  const answer = await fetched("kernel", { method: "POST", body: await file.arrayBuffer() });
  if (!answer) return;
  kernel = (await answer.json()).kernel;
  ask(false);
});

// --- The picture ------------------------------------------------------------------------------------------------

const canvas = $("picture");

function placement() {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth * ratio, height = canvas.clientHeight * ratio;
  const whole = Math.min(width / (hello.width * hello.aspect), height / hello.height);
  const scale = view.zoom || whole, across = scale * hello.aspect;  // Of a pixel's height and width.
  return { scale, across, ratio, left: width / 2 - across * (hello.width / 2 + view.x), top: height / 2 - scale * (hello.height / 2 + view.y) };
}

let drawing = false;
function draw() {
  if (!hello || drawing) return;
  drawing = true;
  requestAnimationFrame(() => { drawing = false; paint(); });
}

function paint() {
  const { scale, across, ratio, left, top } = placement();
  const size = [canvas.clientWidth, canvas.clientHeight].map((each) => Math.round(each * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;  // Which clears it.
  const context = canvas.getContext("2d", { alpha: false });
  const width = hello.width * across, height = hello.height * scale;
  context.fillStyle = getComputedStyle($("stage")).backgroundColor;
  context.fillRect(0, 0, canvas.width, canvas.height);
  const place = (image) => {
    if (!image) return;
    context.imageSmoothingEnabled = width < 3 * image.width;
    context.drawImage(image, left, top, width, height);
  };
  place(images.result ?? images.pinhole);
  const share = Number($("wipe").value) / 100, against = $("against").value;
  if (share > 0) {
    context.save();
    context.beginPath();
    context.rect(left, top, width * share, height);
    context.clip();
    if (against === "difference") {
      context.globalCompositeOperation = "difference";
      place(images.reference);
      context.globalCompositeOperation = "color-dodge";  // Small differences are to be seen.
      context.fillStyle = "#999";
      context.fillRect(left, top, width, height);
    } else place(images[against]);
    context.restore();
    if (share < 1) {
      context.fillStyle = "#fff";
      context.fillRect(left + width * share - 1, top, 2, height);
    }
  }
}

function pixelAt(event) {
  const { scale, across, ratio, left, top } = placement();
  const box = canvas.getBoundingClientRect();
  const x = Math.floor(((event.clientX - box.left) * ratio - left) / across), y = Math.floor(((event.clientY - box.top) * ratio - top) / scale);
  if (x < 0 || y < 0 || x >= hello.width || y >= hello.height) return null;
  return { x: x + hello.left, y: y + hello.top };
}

let grip = null, probed = 0;
canvas.addEventListener("pointerdown", (event) => {
  if (!hello || event.button > 1) return;
  grip = { x: event.clientX, y: event.clientY, view: { ...view }, moved: false };
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  if (!hello) return;
  if (grip) {
    const { scale, across, ratio } = placement();
    const dx = event.clientX - grip.x, dy = event.clientY - grip.y;
    if (Math.hypot(dx, dy) > 4) grip.moved = true;
    if (grip.moved && view.zoom) {
      view.x = grip.view.x - (dx * ratio) / across;
      view.y = grip.view.y - (dy * ratio) / scale;
      draw();
    }
    return;
  }
  const now = performance.now(), pixel = pixelAt(event);
  if (pixel && now - probed > 60) {
    probed = now;
    tell({ type: "probe", ...pixel, settings: { ...settings, kernel } });
  }
});
canvas.addEventListener("pointerleave", () => { $("probe").textContent = ""; });
canvas.addEventListener("pointerup", (event) => {
  const pixel = grip && !grip.moved && event.button === 0 ? pixelAt(event) : null;
  grip = null;
  if (pixel) tell({ type: "focus", ...pixel, keep: event.shiftKey });
});
canvas.addEventListener("wheel", (event) => {
  if (!hello) return;
  event.preventDefault();
  const before = placement(), box = canvas.getBoundingClientRect();
  const x = ((event.clientX - box.left) * before.ratio - before.left) / before.across, y = ((event.clientY - box.top) * before.ratio - before.top) / before.scale;
  const scale = Math.min(Math.max(before.scale * Math.exp(-event.deltaY / 500), 0.05), 64);
  view.x = x - hello.width / 2 - ((x - hello.width / 2 - view.x) * before.scale) / scale;
  view.y = y - hello.height / 2 - ((y - hello.height / 2 - view.y) * before.scale) / scale;
  view.zoom = scale;
  draw();
}, { passive: false });
new ResizeObserver(draw).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

const wipeField = fieldOf($("wipe"));
$("wipe").addEventListener("input", () => { wipeField.value = short($("wipe").value); draw(); });
$("wipe").addEventListener("change", () => { if (isJudging()) ask(false); });
wipeField.addEventListener("change", () => { $("wipe").value = wipeField.value; draw(); });
$("against").addEventListener("change", () => { draw(); if (isJudging()) ask(false); });

// --- Keys, files, shortcuts -------------------------------------------------------------------------------------

function showKeys() {
  $("keys").replaceChildren(...[...keys].sort(([one], [other]) => one - other).map(([frame, focus]) => {
    const item = document.createElement("li"), remove = document.createElement("button");
    item.textContent = `frame ${frame}: ${short(focus)} m `;
    remove.textContent = "remove";
    remove.onclick = () => { keys.delete(frame); showKeys(); };
    item.append(remove);
    return item;
  }));
  $("save-keys").disabled = keys.size === 0;
}

function addKey() { keys.set(Number($("frame-number").value), settings.focus); showKeys(); }

async function download(address, options, name) {
  const answer = await fetched(address, options);
  if (!answer) return;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const save = () => download("save.exr", {}, "out.exr");
const saveKeys = () => download("cameras.zip", { method: "POST", body: JSON.stringify({ settings: { ...settings, kernel }, keys: [...keys] }) }, "cameras.zip");

async function copy() {
  try { await navigator.clipboard.writeText($("command-line").value); } catch { $("command-line").select(); document.execCommand("copy"); }
  $("copy").textContent = "Copied";
  setTimeout(() => { $("copy").textContent = "Copy command"; }, 1500);
}

$("save").onclick = save;
$("copy").onclick = copy;
$("reset").onclick = reset;
$("add-key").onclick = addKey;
$("save-keys").onclick = saveKeys;

const change = (name, value) => { set(name, value); ask(false); };
const shortcuts = {
  "[": () => change("f_number", settings.f_number / 2 ** 0.25),
  "]": () => change("f_number", settings.f_number * 2 ** 0.25),
  ",": () => change("focus", settings.focus / 1.05),
  ".": () => change("focus", settings.focus * 1.05),
  "+": () => change("exposure", settings.exposure + 0.5),
  "-": () => change("exposure", settings.exposure - 0.5),
  o: () => { const all = [...$("overlay").options].map((each) => each.value); change("overlay", all[(all.indexOf(settings.overlay) + 1) % all.length]); },
  w: () => { $("wipe").value = Number($("wipe").value) ? 0 : 50; $("wipe").dispatchEvent(new Event("input")); $("wipe").dispatchEvent(new Event("change")); },
  k: addKey, s: save, c: copy,
  0: () => { view.zoom = view.x = view.y = 0; draw(); },
  1: () => { view.zoom = 1; draw(); },
};
addEventListener("keydown", (event) => {
  const typing = event.target.matches("textarea, select, input:not([type=range])");
  if (typing || event.ctrlKey || event.metaKey || event.altKey || !hello) return;
  const action = shortcuts[event.key];
  if (action) { event.preventDefault(); action(); }
});

connect();
