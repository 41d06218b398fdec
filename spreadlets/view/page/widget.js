// The picture of a notebook's widget and its sliders. The kernel renders; a drag asks again only once it has answered.
const NAMES = {
  f_number: "f-number",
  focal_length: "focal length, mm",
  focus: "focus, m",
  shutter: "shutter, degrees",
  exposure: "exposure, stops",
  blades: "blades",
};
const LOGARITHMIC = ["f_number", "focal_length", "focus"];

function render({ model, el }) {
  const canvas = document.createElement("canvas"), status = document.createElement("output");
  const sliders = {};
  let waiting = false, next = null;

  // One request is under way at a time; of those that come meanwhile the newest waits.
  function ask(message) {
    if (waiting) {
      next = message;
      return;
    }
    waiting = true;
    model.send(message);
  }

  function answered() {
    waiting = false;
    if (next) {
      const message = next;
      next = null;
      ask(message);
    }
  }

  function show() {
    for (const [name, { input, label }] of Object.entries(sliders)) {
      const value = model.get("settings")[name];
      if (document.activeElement !== input || next === null) input.value = toSlider(name, value);
      label.textContent = `${NAMES[name]}: ${Number(value.toPrecision(4))}`;
    }
  }

  const toSlider = (name, value) => (LOGARITHMIC.includes(name) ? Math.log2(value) : value);
  const fromSlider = (name, value) => (LOGARITHMIC.includes(name) ? 2 ** value : value);

  // A slider for each setting: proxies while it is dragged, the whole picture when it is let go.
  const controls = document.createElement("div");
  controls.style.cssText = "display:grid;grid-template-columns:repeat(auto-fit,minmax(12em,1fr));gap:0 1em";
  for (const name of Object.keys(NAMES)) {
    const label = document.createElement("label"), text = document.createElement("span");
    const input = document.createElement("input");
    const [least, most] = model.get("ranges")[name];
    Object.assign(input, { type: "range", min: toSlider(name, least), max: toSlider(name, most) });
    input.step = name === "blades" ? 1 : (input.max - input.min) / 500;
    input.style.width = "100%";
    const change = (dragging) => {
      const value = fromSlider(name, Number(input.value));
      // No aperture has one blade or two.
      if (name === "blades" && (value === 1 || value === 2)) return;
      ask({ settings: { [name]: value }, dragging });
    };
    input.addEventListener("input", () => change(name !== "blades"));
    input.addEventListener("change", () => change(false));
    label.append(text, input);
    controls.append(label);
    sliders[name] = { input, label: text };
  }

  canvas.style.cssText = "max-width:100%;cursor:crosshair;display:block";
  canvas.addEventListener("click", (event) => {
    const place = canvas.getBoundingClientRect(), [height, width] = model.get("shape");
    const x = ((event.clientX - place.left) / place.width) * width;
    const y = ((event.clientY - place.top) / place.height) * height;
    ask({ click: [Math.floor(x), Math.floor(y)] });
  });

  model.on("change:settings", show);
  model.on("msg:custom", (message, buffers) => {
    if (message.type === "picture") {
      const bytes = new Uint8ClampedArray(buffers[0].buffer, buffers[0].byteOffset, buffers[0].byteLength);
      Object.assign(canvas, { width: message.width, height: message.height });
      canvas.getContext("2d").putImageData(new ImageData(bytes.slice(), message.width, message.height), 0, 0);
      canvas.style.width = `${model.get("shape")[1]}px`;
      status.textContent = message.full ? `ready: ${message.time_s.total.toFixed(2)} s` : "drawing";
    } else if (message.type === "progress") {
      status.textContent = `building ${message.done} of ${message.total}`;
      return;
    } else if (message.type === "error") {
      status.textContent = message.text;
    }
    answered();
  });
  el.append(canvas, status, controls);
  show();
  ask({});
}

export default { render };
