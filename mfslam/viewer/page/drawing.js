// Everything on the map but the tiles. Lines are in metres, their widths in pixels.

const CHI2_95 = 2.448; // 95 % of a normal distribution in the plane, as a radius in sigmas
const SIGMAS_95 = 1.96; // and on a line
const ROBOT_M = 0.35, ROBOT_LEAST_PX = 13;

export function draw(canvas, camera, model, tiles, layers, colours) {
  const ratio = devicePixelRatio, width = Math.round(camera.width * ratio), height = Math.round(camera.height * ratio);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const ctx = canvas.getContext("2d", { alpha: false });
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.fillStyle = colours.page;
  ctx.fillRect(0, 0, width, height);
  const k = camera.scale * ratio;
  ctx.setTransform(k, 0, 0, -k, width / 2 - camera.x * k, height / 2 + camera.y * k);
  const px = 1 / camera.scale; // a CSS pixel, in metres
  ctx.lineJoin = ctx.lineCap = "round";
  if (layers.map) tiles.draw(ctx, camera, colours);
  if (layers.grid) grid(ctx, camera, colours, px);
  if (layers.loops) loops(ctx, model, colours, px);
  if (layers.path) path(ctx, model, colours, px);
  if (layers.keyframes) keyframes(ctx, model, colours, px);
  if (layers.scan) scan(ctx, model, colours, px);
  if (!model.robot) return;
  if (layers.uncertainty) uncertainty(ctx, model.robot, colours, px);
  robot(ctx, model.robot, colours, px);
}

// The greatest round step (1, 2, 5 times a power of ten) of at most so many metres.
export function roundStep(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return [5, 2, 1].map((m) => m * power).find((m) => m <= metres * 1.0001) ?? power;
}

// 95 % ellipse of a covariance [xx, xy, xyaw, yy, yyaw, yawyaw]: half axes (m) and direction (rad).
export function ellipse([xx, xy, , yy]) {
  const mean = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
  return {
    major: CHI2_95 * Math.sqrt(Math.max(0, mean + apart)),
    minor: CHI2_95 * Math.sqrt(Math.max(0, mean - apart)),
    angle: 0.5 * Math.atan2(2 * xy, xx - yy),
  };
}

export const headingSpread = (covariance) => SIGMAS_95 * Math.sqrt(Math.max(0, covariance[5]));

function grid(ctx, camera, colours, px) {
  const step = roundStep(camera.width / camera.scale / 6), [left, low, right, top] = camera.box();
  ctx.strokeStyle = colours.grid;
  ctx.lineWidth = px;
  ctx.beginPath();
  for (let x = Math.ceil(left / step) * step; x < right; x += step) { ctx.moveTo(x, low); ctx.lineTo(x, top); }
  for (let y = Math.ceil(low / step) * step; y < top; y += step) { ctx.moveTo(left, y); ctx.lineTo(right, y); }
  ctx.stroke();
  for (const [x, y, colour] of [[1, 0, colours.bad], [0, 1, colours.good]]) {
    ctx.strokeStyle = colour;
    ctx.lineWidth = 2.5 * px;
    ctx.beginPath();
    ctx.moveTo(0, 0);
    ctx.lineTo(x, y);
    ctx.stroke();
  }
}

function path(ctx, model, colours, px) {
  const xy = model.path;
  ctx.strokeStyle = colours.path;
  ctx.lineWidth = 2 * px;
  ctx.beginPath();
  for (let k = 0; k < 2 * model.pathShown; k += 2) ctx.lineTo(xy[k], xy[k + 1]);
  if (model.robot) ctx.lineTo(model.robot.pose[0], model.robot.pose[1]);
  ctx.stroke();
}

function keyframes(ctx, model, colours, px) {
  const xy = model.keyframes;
  ctx.strokeStyle = colours.path;
  ctx.lineWidth = 5 * px;
  ctx.beginPath();
  for (let k = 0; k < 2 * model.keyframesShown; k += 2) { ctx.moveTo(xy[k], xy[k + 1]); ctx.lineTo(xy[k], xy[k + 1] + 1e-6); }
  ctx.stroke();
}

function loops(ctx, model, colours, px) {
  const pairs = model.loops, xy = model.keyframes, shown = model.keyframesShown;
  ctx.strokeStyle = colours.loops;
  ctx.globalAlpha = 0.55;
  ctx.lineWidth = 1.2 * px;
  ctx.beginPath();
  for (let k = 0; k + 1 < pairs.length; k += 2) {
    const i = pairs[k], j = pairs[k + 1];
    if (i >= shown || j >= shown) continue;
    ctx.moveTo(xy[2 * i], xy[2 * i + 1]);
    ctx.lineTo(xy[2 * j], xy[2 * j + 1]);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function scan(ctx, model, colours, px) {
  const xy = model.scan, half = Math.max(1.4 * px, 0.012);
  ctx.fillStyle = colours.hit;
  for (let k = 0; k + 1 < xy.length; k += 2) ctx.fillRect(xy[k] - half, xy[k + 1] - half, 2 * half, 2 * half);
}

function uncertainty(ctx, { pose: [x, y, yaw], covariance }, colours, px) {
  if (covariance.includes(null)) return;
  const { major, minor, angle } = ellipse(covariance), spread = Math.min(Math.PI, headingSpread(covariance));
  ctx.strokeStyle = ctx.fillStyle = colours.unsure;
  ctx.lineWidth = 1.5 * px;
  ctx.beginPath();
  ctx.moveTo(x, y);
  ctx.arc(x, y, Math.max(1, 70 * px), yaw - spread, yaw + spread);
  ctx.closePath();
  ctx.globalAlpha = 0.3;
  ctx.fill();
  ctx.beginPath();
  ctx.ellipse(x, y, Math.max(major, px), Math.max(minor, px), angle, 0, 2 * Math.PI);
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.stroke();
}

function robot(ctx, { pose: [x, y, yaw] }, colours, px) {
  const r = Math.max(ROBOT_M, ROBOT_LEAST_PX * px);
  ctx.save();
  ctx.translate(x, y);
  ctx.rotate(yaw);
  ctx.beginPath();
  ctx.moveTo(r, 0);
  ctx.lineTo(-0.7 * r, 0.62 * r);
  ctx.lineTo(-0.38 * r, 0);
  ctx.lineTo(-0.7 * r, -0.62 * r);
  ctx.closePath();
  ctx.fillStyle = colours.path;
  ctx.strokeStyle = colours.outline;
  ctx.lineWidth = 2 * px;
  ctx.fill();
  ctx.stroke();
  ctx.restore();
}
