// The engine's answers from ONNX Runtime Web and the model file alone: see docs/model_file.md.
import * as ort from "onnxruntime-web/wasm";

ort.env.wasm.proxy = true; // in a worker: the page stays alive

/** Open the bytes of a model file: its session, and its contract, the metadata. */
export async function openModel(bytes) {
  const contract = await readContract(bytes);
  return { contract, session: await ort.InferenceSession.create(bytes) };
}

/** [height, width] at which the network runs for a frame of this size. */
export function networkSize({ session, contract }, [height, width]) {
  const { shape } = session.inputMetadata.find(({ name }) => name === "rgb");
  if (typeof shape[1] === "number") return shape.slice(1, 3);
  const rows = contract.trained_height;
  if (!rows || height <= 1.25 * rows) return [height, width];
  return [rows, Math.max(32, Math.round((width * rows) / height))];
}

/** Move each return of a depth map to its pixel at another size, where the nearest stays. */
export function moveReturns(depth, [height, width], [newHeight, newWidth]) {
  const moved = new Float32Array(newHeight * newWidth);
  depth.forEach((metres, index) => {
    const row = movedPixel(Math.floor(index / width), height, newHeight);
    const at = row * newWidth + movedPixel(index % width, width, newWidth);
    if (metres > 0 && !(moved[at] > 0 && moved[at] <= metres)) moved[at] = metres;
  });
  return moved;
}

/**
 * Predict a frame of the network's size: ImageData, float32 metres (0 = no return) and the focal
 * length in its pixels (0 = not known). A larger frame's depth is not moved to its own returns, as
 * docs/model_file.md describes for answers at the frame's size. Returns each head's plane;
 * valid: false = do not use them.
 */
export async function predict({ session, contract }, { data, height, width }, depth, focal) {
  const started = performance.now();
  const limit = contract.max_depth_m;
  const factor = (focal && contract.canonical_focal_px / focal) || 1; // to canonical metres
  const range = limit / factor;
  const farthest = Math.max(range, 250); // as the engine: beyond it is no return
  const fed = depth.map((metres) => (metres <= farthest ? Math.min(metres * factor, limit) : 0));
  const rgb = new Uint8Array(data.filter((_, index) => index % 4 < 3).buffer); // of RGBA
  const feeds = {
    rgb: new ort.Tensor("uint8", rgb, [1, height, width, 3]),
    sparse_depth: new ort.Tensor("float32", fed, [1, height, width]),
  };
  const planes = session.outputMetadata.filter(({ shape }) => shape.length === 3);
  const outputs = await session.run(feeds, planes.map(({ name }) => name));
  const heads = {};
  for (const [name, { data }] of Object.entries(outputs)) {
    const metric = name === "depth" || name === "depth_uncertainty";
    heads[name] = metric ? data.map((metres) => metres / factor) : data;
  }
  const most = { semantic: contract.classes.length - 1, depth: range * 1.001, boundary: 1.001 };
  const valid = Object.entries(heads).every(([name, values]) =>
    values.every((value) => value >= -0.001 * range && value <= (most[name] ?? 1e30)),
  );
  const latency = performance.now() - started;
  return { heads, range, valid, latency, threads: ort.env.wasm.numThreads };
}

/** The metadata, which is the end of a model file, checked by its digests. */
async function readContract(bytes) {
  const end = new TextDecoder("latin1").decode(bytes.subarray(-(2 ** 22)));
  const entry = end.lastIndexOf("\n\x06ssdnet\x12"); // of ModelProto.metadata_props
  if (entry < 0) throw Error("it does not end as ssdnet-export ends it");
  const text = end.slice(entry + 9).replace(/^[^\0-\x7f]*[\0-\x7f]/, ""); // after its length
  const contract = JSON.parse(text);
  const { schema_version: version, content, document_sha256: digest } = contract;
  if (version !== "1.4") throw Error(`its schema is ${version}, and this page reads 1.4`);
  if (!contract.classes.every(({ color }) => isColor(color))) // written into the page's CSS
    throw Error("a colour of its classes is not three whole numbers of 0 to 255");
  if (!crypto.subtle) return contract; // neither https nor localhost
  const document = text.slice(0, text.lastIndexOf(', "document_sha256"'));
  const found = [bytes.subarray(0, content.bytes), new TextEncoder().encode(document)];
  const digests = await Promise.all(found.map(sha256));
  if (digests[0] === content.sha256 && digests[1] === digest) return contract;
  throw Error("it is not as it was exported: get it again");
}

function isColor(color) {
  const isByte = (part) => Number.isInteger(part) && part >= 0 && part <= 255;
  return Array.isArray(color) && color.length === 3 && color.every(isByte);
}

async function sha256(bytes) {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** rint((pixel + 0.5) * to / from - 0.5), half to even. */
function movedPixel(pixel, from, to) {
  const at = ((2 * pixel + 1) * to - from) / (2 * from);
  return at % 1 === 0.5 ? 2 * Math.round(at / 2) : Math.round(at);
}
