// The page: brings stream, model, map and figures together.

import { Camera } from "./camera.js";
import { draw, roundStep } from "./drawing.js";
import { Stream } from "./live.js";
import { Model } from "./model.js";
import { showLink, showRobot, showStatus, toast } from "./panel.js";
import { Replay } from "./replay.js";
import { Tiles } from "./tiles.js";

const $ = (id) => document.getElementById(id);
const canvas = $("map");
let dirty = true, colours = {}, frames = 0;
const changed = () => { dirty = true; };
const model = new Model();
const tiles = new Tiles(changed);
const camera = new Camera(canvas, () => { showFollowing(); changed(); });
const layers = {};
let replay = null, hello = {};
const narrow = matchMedia("(max-width: 700px)");

// --- colours ---------------------------------------------------------------------------------------------

const systemDark = matchMedia("(prefers-color-scheme: dark)");
let theme = localStorage.getItem("mfslam-theme") ?? "auto";

function applyTheme() {
  document.documentElement.classList.toggle("dark", theme === "dark" || (theme === "auto" && systemDark.matches));
  $("theme").title = `colours: ${theme === "auto" ? "as the system has them" : theme}`;
  const style = getComputedStyle(document.documentElement);
  const text = (name) => style.getPropertyValue(`--${name}`).trim();
  for (const name of ["page", "path", "loops", "hit", "unsure", "grid", "good", "bad"]) colours[name] = text(name);
  // pixels of ImageData as one number: alpha, blue, green, red from the high byte on
  const pixel = (hex) => (255 << 24 | parseInt(hex.slice(5, 7), 16) << 16 | parseInt(hex.slice(3, 5), 16) << 8 | parseInt(hex.slice(1, 3), 16)) >>> 0;
  [colours.free, colours.wall] = [pixel(text("free")), pixel(text("wall"))];
  colours.outline = text("free");
  tiles.recolour();
}
systemDark.addEventListener("change", applyTheme);
$("theme").addEventListener("click", () => {
  theme = { auto: "light", light: "dark", dark: "auto" }[theme];
  localStorage.setItem("mfslam-theme", theme);
  applyTheme();
});

// --- what is seen ----------------------------------------------------------------------------------------

function everything() {
  const box = tiles.box() ?? [Infinity, Infinity, -Infinity, -Infinity];
  const include = (x, y) => {
    [box[0], box[1], box[2], box[3]] = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
  };
  for (let k = 0; k < model.path.length; k += 2) include(model.path[k], model.path[k + 1]);
  if (model.robot) include(model.robot.pose[0], model.robot.pose[1]);
  for (let k = 0; k < model.scan.length; k += 2) include(model.scan[k], model.scan[k + 1]);
  return box[0] <= box[2] ? box : null;
}

function showWhole() {
  const box = everything(), open = !$("panel").hidden;
  if (!box) return;
  const bottom = replay ? 80 : 45;
  camera.fit(box, narrow.matches
    ? { left: 20, right: 20, top: 115, bottom: open ? camera.height * 0.42 + 10 : bottom }
    : { left: 30, right: open ? 330 : 30, top: 75, bottom });
}

function showFollowing() { $("follow").setAttribute("aria-pressed", String(camera.following)); }

$("follow").addEventListener("click", () => {
  camera.following = !camera.following;
  showFollowing();
  changed();
});
$("whole").addEventListener("click", () => {
  camera.following = false;
  camera.touched = true;
  showWhole();
  showFollowing();
});
for (const input of document.querySelectorAll("#layers input")) {
  const apply = () => { layers[input.value] = input.checked; changed(); };
  input.addEventListener("change", apply);
  apply();
}
document.addEventListener("pointerdown", (event) => {
  if (!$("layers").contains(event.target)) $("layers").open = false;
});
function showPanel(open) {
  $("panel").hidden = !open;
  $("panel-switch").setAttribute("aria-expanded", String(open));
}
$("panel-switch").addEventListener("click", () => showPanel($("panel").hidden));
showPanel(!narrow.matches);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || ["INPUT", "SELECT"].includes(event.target.tagName)) return;
  const act = { f: () => $("follow").click(), w: () => $("whole").click(), "+": () => camera.zoom(1.4), "-": () => camera.zoom(1 / 1.4) };
  if (event.key === " " && replay && event.target.tagName !== "BUTTON") {
    event.preventDefault();
    $("play").click();
  } else act[event.key.toLowerCase()]?.();
});
canvas.addEventListener("pointermove", (event) => {
  const [x, y] = camera.toWorld(event.clientX, event.clientY);
  $("where").textContent = `x ${x.toFixed(2)} m, y ${y.toFixed(2)} m`;
});
canvas.addEventListener("pointerleave", () => { $("where").textContent = ""; });

function showScale() {
  const step = roundStep(140 / camera.scale);
  const text = step < 1 ? `${Math.round(step * 100)} cm` : `${step} m`;
  if ($("scale").textContent !== text) $("scale").textContent = text;
  $("scale").style.width = `${step * camera.scale}px`;
}

// --- the stream ------------------------------------------------------------------------------------------

const stream = new Stream({
  hello(value) {
    hello = value;
    $("title").textContent = value.title;
    document.title = `${value.title} - mfslam`;
    $("save").hidden = !value.save;
    $("save").textContent = value.mode === "run" ? "download" : "save map";
    tiles.reconnected();
    if (value.mode === "run" && !replay) startReplay();
  },
  news(message) {
    if (message.map) tiles.take(message.map);
    if (message.path) {
      model.takePath(message.path);
      if (replay?.path) [model.path, model.pathShown] = [replay.path, replay.index + 1];
    }
    if (message.loops) model.takeLoops(message.loops);
    if (message.robot) model.takeRobot(message.robot);
    if (message.status) showStatus(message.status);
    changed();
  },
  link: showLink,
  begun: () => model.robot !== null,
});

$("save").addEventListener("click", async () => {
  const download = { text: "download the map", href: "map.zip" };
  if (hello.mode === "run") {
    location.href = download.href;
    return;
  }
  $("save").disabled = true;
  toast("saving the map on the robot's machine ...");
  try {
    const reply = await fetch("save", { method: "POST", headers: { "X-Mfslam": "save" } });
    const answer = await reply.json();
    if (answer.error) toast(`not saved: ${answer.error}`, { bad: true });
    else toast(answer.text, { link: download });
  } catch {
    toast("not saved: the robot's machine does not answer", { bad: true });
  } finally {
    $("save").disabled = false;
  }
});

// --- a finished run --------------------------------------------------------------------------------------

const clockText = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

async function startReplay() {
  replay = new Replay(model, tiles, changed);
  camera.following = false;
  showFollowing();
  document.body.classList.add("timed");
  await replay.load();
  const slider = $("time");
  slider.max = replay.end;
  $("timeline").hidden = false;
  slider.addEventListener("input", () => { replay.playing = false; replay.seek(Number(slider.value)); });
  $("play").addEventListener("click", () => { replay.toggle(); changed(); });
  $("speed").addEventListener("change", () => { replay.speed = Number($("speed").value); });
}

function showTime() {
  $("play").textContent = replay.playing ? "pause" : "play";
  if (document.activeElement !== $("time") || replay.playing) $("time").value = replay.t;
  $("clock").textContent = `${clockText(replay.t)} / ${clockText(replay.end ?? 0)}`;
}

// --- frames ----------------------------------------------------------------------------------------------

let lastMs = performance.now();
function frame(nowMs) {
  const seconds = Math.min(0.25, (nowMs - lastMs) / 1000);
  lastMs = nowMs;
  replay?.table && replay.step(seconds);
  if (dirty) {
    dirty = false;
    if (!camera.touched && !(model.robot && camera.following)) showWhole();
    else if (camera.following && model.robot) camera.lookAt(model.robot.pose[0], model.robot.pose[1]);
    draw(canvas, camera, model, tiles, layers, colours);
    showScale();
    showRobot(model);
    if (replay?.table) showTime();
    dirty = false;
    frames++;
  }
  requestAnimationFrame(frame);
}
new ResizeObserver(changed).observe(canvas);
applyTheme();
requestAnimationFrame(frame);

// for the curious, and for tests
window.mfslam = { model, tiles, camera, stream, get replay() { return replay; }, get frames() { return frames; } };
