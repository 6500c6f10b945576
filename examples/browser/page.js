// The files that are dropped on the page, and the pictures of the answer.
import { decode } from "fast-png";
import { moveReturns, networkSize, openModel, predict } from "./ssdnet.js";

const BUNDLED = ["ssdnet-lite.onnx", "stream/rgb/00000.jpg", "stream/depth/00000.png"];
const MAGMA = colors("fcfdbf fec287 fb8761 e55064 b73779 832681 51127c 1d1147 000004");
const VIRIDIS = colors("440154 472d7b 3b528b 2c728e 21918c 27ad81 5cc863 aadc32 fde725");
const GRAY = colors("000000 ffffff");
const NO_VALUE = [110, 110, 110];

const { error, facts, files, focal, pictures } = window; // the elements by their ids
const readers = {
  model: openModel,
  // Turned by its EXIF orientation, which the engine ignores.
  image: (bytes) => createImageBitmap(new Blob([bytes]), { colorSpaceConversion: "none" }),
  depth: (bytes) => {
    const { data, height, width } = decode(bytes);
    return { height, width, metres: Float32Array.from(data, (value) => value / 256) };
  },
};
window.shown = {}; // model, image and depth, and of these pixels, fed and answer
let last = Promise.resolve();

/** Run a task with a value after those before it, and show its error. */
function start(task, value) {
  document.body.className = "busy";
  last = last.then(() => task(value)).then(() => "", ({ message }) => message).then((message) => {
    error.textContent = message;
    document.body.className = "";
  });
}

/** Read files, and predict the frame that they make with those before. */
async function take(dropped) {
  const given = {};
  for (const file of dropped) {
    const bytes = new Uint8Array(await file.arrayBuffer());
    const kind = kindOf(file.name, bytes);
    if (given[kind]) throw Error(`${file.name} is a second ${kind}. Depth is a 16-bit gray PNG.`);
    try {
      given[kind] = Object.assign(await readers[kind](bytes), { name: file.name });
    } catch ({ message }) {
      throw Error(`${file.name} is damaged, or no ${kind} for this page: ${message}`);
    }
  }
  await predictFrame({ ...shown, ...(given.image && { depth: null }), ...given });
}

/** "model", "depth" (a PNG of 16 bits and one channel) or "image". */
function kindOf(name, bytes) {
  if (name.toLowerCase().endsWith(".onnx")) return "model";
  const png = bytes[0] === 0x89 && bytes[1] === 0x50;
  return png && bytes[24] === 16 && bytes[25] === 0 ? "depth" : "image";
}

async function predictFrame({ model, image, depth }) {
  if (image && depth && (image.height !== depth.height || image.width !== depth.width))
    throw Error(`${depth.name} is ${size(depth)}, the image ${size(image)}: drop its own depth.`);
  if (image?.height < 32 || image?.width < 32) throw Error(`The image is smaller than 32 × 32.`);
  shown = { model, image, depth };
  if (model && image) {
    const frame = [image.height, image.width];
    const [height, width] = networkSize(model, frame);
    const canvas = new OffscreenCanvas(width, height).getContext("2d");
    canvas.imageSmoothingQuality = "high"; // where the size is another: the browser's resizing
    canvas.drawImage(image, 0, 0, width, height);
    const pixels = canvas.getImageData(0, 0, width, height);
    const metres = depth?.metres ?? new Float32Array(image.height * image.width);
    const fed = moveReturns(metres, frame, [height, width]);
    const magnified = Math.sqrt((height * width) / (image.height * image.width));
    const answer = await predict(model, pixels, fed, focal.value * magnified);
    Object.assign(shown, { pixels, fed, answer });
  }
  show();
  if (shown.answer?.valid === false) throw Error("Values are out of range: do not use them.");
}

function show() {
  const { model, image, depth, pixels, answer } = shown;
  const lines = {
    Model: model && `${model.contract.model_name}, ${model.contract.precision}`,
    Image: image && `${image.name}, ${size(image)}`,
    Depth: depth && `${depth.name}, ${depth.metres.filter(Boolean).length} returns`,
    "Network runs at": answer && size(pixels),
    "Time (the first is slower)": answer && `${answer.latency.toFixed()} ms, threads: ${answer.threads}`,
  };
  const paragraph = ([name, fact]) => make("p", make("b", name), fact || "–");
  facts.replaceChildren(...Object.entries(lines).map(paragraph));
  pictures.replaceChildren(...(answer ? draw(shown) : []));
}

function draw({ model, pixels, fed, answer: { heads, range } }) {
  const { classes } = model.contract;
  const { semantic, depth, boundary, depth_uncertainty: uncertainty } = heads;
  const nearest = Math.min(3, range / 10);
  const sky = classes.findIndex(({ name }) => name.toLowerCase() === "sky");
  const hidden = (at) => !(depth[at] > 0) || (sky >= 0 && semantic?.[at] === sky);
  const metric = (metres) => ramp(MAGMA, Math.log(metres / nearest) / Math.log(range / nearest));
  const part = (at) => ramp(VIRIDIS, 1 + Math.log10(uncertainty[at] / depth[at]) / 2);
  const image = (at) => pixels.data.subarray(4 * at, 4 * at + 3);
  const color = (id) => classes[id]?.color ?? NO_VALUE;
  const names = classes.map(({ name, color }) => make("span", swatch([color, color]), name));
  const returns = ["returns in the colours of the depth"];
  const scale = [`${nearest} m`, swatch(MAGMA), `${range.toFixed()} m (gray: none)`];
  const percent = ["1 %", swatch(VIRIDIS), "100 % of the depth"];
  return [
    figure("Image", returns, (at) => (fed[at] ? metric(fed[at]) : image(at))),
    semantic && figure("Classes", names, (at) => mix(image(at), color(semantic[at]), 0.7)),
    depth && figure("Depth", scale, (at) => (hidden(at) ? NO_VALUE : metric(depth[at]))),
    uncertainty && figure("Uncertainty", percent, (at) => (hidden(at) ? NO_VALUE : part(at))),
    boundary && figure("Boundary", ["0", swatch(GRAY), "1"], (at) => ramp(GRAY, boundary[at])),
  ].filter(Boolean);
}

function figure(title, legend, colorAt) {
  const { height, width } = shown.pixels;
  const canvas = Object.assign(make("canvas"), { height, width });
  const colored = new ImageData(width, height);
  for (let at = 0; at < height * width; at++) colored.data.set([...colorAt(at), 255], 4 * at);
  canvas.getContext("2d").putImageData(colored, 0, 0);
  return make("figure", canvas, make("figcaption", make("b", title), ...legend));
}

async function fetched(path) {
  const response = await fetch(`../../runtime/assets/${path}`);
  if (!response.ok) throw Error(`No bundled ${path} here: drop a model (.onnx) and an image.`);
  return new File([await response.blob()], path.replace(/.*\//, ""));
}

const size = ({ height, width }) => `${width} × ${height}`;

function make(tag, ...children) {
  const element = document.createElement(tag);
  element.append(...children);
  return element;
}

function swatch(colors) {
  const element = make("i");
  element.style.background = `linear-gradient(90deg, ${colors.map((rgb) => `rgb(${rgb})`)})`;
  return element;
}

/** The colour at a share of the way along equally spaced colours. */
function ramp(colors, share) {
  const way = Math.min(Math.max(share || 0, 0), 1) * (colors.length - 1);
  const low = Math.min(Math.floor(way), colors.length - 2);
  return mix(colors[low], colors[low + 1], way - low);
}

function mix(from, to, share) {
  return to.map((value, channel) => share * value + (1 - share) * from[channel]);
}

function colors(hexes) {
  const bytes = (hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
  return hexes.split(" ").map(bytes);
}

files.onchange = () => start(take, [...files.files]);
files.onclick = () => (files.value = ""); // so that the same file is a change
focal.onchange = () => start(() => predictFrame(shown));
document.ondragover = (event) => event.preventDefault();
document.ondrop = (event) => {
  event.preventDefault();
  start(take, [...event.dataTransfer.files]);
};
start(async () => take(await Promise.all(BUNDLED.map(fetched))));
