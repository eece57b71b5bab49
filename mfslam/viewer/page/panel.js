// The figures beside the map, in words.

import { ellipse, headingSpread } from "./drawing.js";

const $ = (id) => document.getElementById(id);
const NAMES = { median: "median", p99: "99 % below", worst: "worst", latest: "latest", cpu_p99: "99 %, processor alone", cpu_worst: "worst, processor alone" };

// As much precision as helps a reader.
const brief = (value) => {
  if (typeof value !== "number") return value === null || value === undefined ? "unknown" : String(value);
  if (Number.isInteger(value)) return value.toLocaleString("en").replaceAll(",", " ");
  return value.toPrecision(3).replace(/e\+?(-?)(\d+)$/, " × 10^$1$2");
};
const metres = (m) => (m < 0.1 ? `${(m * 1e3).toFixed(m < 0.01 ? 1 : 0)} mm` : `${m.toFixed(2)} m`);
const fixed = (v, digits) => (Math.abs(v) < 0.5 * 10 ** -digits ? 0 : v).toFixed(digits);
const degrees = (rad, digits = 1) => `${((rad * 180) / Math.PI).toFixed(digits)}°`;

// Names such as travelled_m: words, and the unit behind the value.
function named(key, value) {
  const unit = /_(m|s|ms|hz|mb|m2)$/.exec(key)?.[1];
  const words = (unit ? key.slice(0, -unit.length - 1) : key).replaceAll("_", " ");
  return [words, unit ? `${brief(value)} ${{ hz: "Hz", mb: "MB", m2: "m²" }[unit] ?? unit}` : brief(value)];
}

function list(id, pairs) {
  $(id).replaceChildren(...pairs.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  const part = $(`${id}-part`);
  if (part) part.hidden = !pairs.length;
}

function element(tag, text, className = "") {
  const out = document.createElement(tag);
  out.textContent = text;
  out.className = className;
  return out;
}

export function showRobot(model) {
  if (!model.robot) {
    list("robot", [["position", "not known yet"]]);
    return;
  }
  const { pose: [x, y, yaw], covariance } = model.robot;
  const pairs = [["position", `${fixed(x, 2)}, ${fixed(y, 2)} m`], ["heading", degrees(Math.atan2(Math.sin(yaw), Math.cos(yaw)))]];
  if (model.speed !== null) pairs.push(["speed", `${model.speed.toFixed(2)} m/s`]);
  if (covariance && !covariance.includes(null)) {
    pairs.push(["within (95 %)", `${metres(ellipse(covariance).major)}, ${degrees(headingSpread(covariance), 2)}`]);
  }
  list("robot", pairs);
}

export function showStatus({ health = [], counts = {}, latency_ms = {}, notes = [] }) {
  $("sensors").replaceChildren(...health.map(sensor));
  $("sensors-part").hidden = !health.length;
  list("latency", Object.entries(latency_ms).map(([key, v]) => [NAMES[key] ?? key.replaceAll("_", " "), v === null ? "unknown" : `${v.toFixed(1)} ms`]));
  list("counts", Object.entries(counts).map(([key, v]) => named(key, v)));
  $("notes").replaceChildren(...notes.map((text) => element("li", text)));
  $("notes-part").hidden = !notes.length;
}

function sensor(health) {
  const errors = Object.entries(health.errors ?? {}), total = errors.reduce((sum, [, n]) => sum + n, 0);
  const row = element("div", "", "sensor");
  const state = !health.connected ? "bad" : total || health.reconnects ? "warn" : "";
  row.append(element("span", "", `dot ${state}`), element("b", health.name));
  row.append(element("span", health.connected ? `${health.rate_hz.toFixed(1)} Hz, ${(health.delay_s * 1e3).toFixed(0)} ms late` : "no data"));
  if (!health.connected) row.append(element("p", health.text, "bad"));
  if (total) row.append(element("p", `${brief(total)} errors: ${errors.map(([kind, n]) => `${kind} ${brief(n)}`).join(", ")}`));
  if (health.reconnects) row.append(element("p", `lost and found again ${health.reconnects} times`.replace(" 1 times", " once")));
  if (health.advice) row.append(element("p", health.advice));
  return row;
}

export function showLink(text, kind) {
  const pill = $("link");
  if (pill.textContent !== text) pill.textContent = text;
  pill.className = `pill ${kind}`;
}

let toastEnds;
export function toast(text, { bad = false, link = null } = {}) {
  const box = $("toast");
  box.replaceChildren(document.createTextNode(text));
  if (link) {
    const a = element("a", link.text);
    a.href = link.href;
    a.download = "";
    box.append(document.createTextNode(" "), a);
  }
  box.classList.toggle("bad", bad);
  box.hidden = false;
  clearTimeout(toastEnds);
  toastEnds = setTimeout(() => { box.hidden = true; }, link ? 30000 : 8000);
}
