// What part of the world is seen: centre (m), scale (CSS pixels a metre), and the gestures that change it.

const LEAST = 0.5, MOST = 2000;

export class Camera {
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.changed = changed;
    this.x = 0;
    this.y = 0;
    this.scale = 60;
    this.following = true;
    this.touched = false; // by the user: from then on nothing zooms by itself
    this.pointers = new Map();
    this.listen();
  }

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }

  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  // The world's part in sight: left, low, right, top.
  box() {
    const w = this.width / 2 / this.scale, h = this.height / 2 / this.scale;
    return [this.x - w, this.y - h, this.x + w, this.y + h];
  }

  lookAt(x, y) {
    if (x === this.x && y === this.y) return;
    this.x = x;
    this.y = y;
    this.changed();
  }

  // Show a box of the world, beside what covers the page's edges.
  fit([left, low, right, top], margins = { left: 30, right: 30, top: 80, bottom: 40 }) {
    const w = Math.max(80, this.width - margins.left - margins.right);
    const h = Math.max(80, this.height - margins.top - margins.bottom);
    this.scale = clamp(Math.min(w / Math.max(right - left, 1), h / Math.max(top - low, 1)));
    this.x = (left + right) / 2 + (margins.right - margins.left) / 2 / this.scale;
    this.y = (low + top) / 2 + (margins.top - margins.bottom) / 2 / this.scale;
    this.changed();
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.toWorld(px, py);
    this.scale = clamp(this.scale * factor);
    const after = this.toWorld(px, py);
    if (!this.following) {
      this.x += before[0] - after[0];
      this.y += before[1] - after[1];
    }
    this.touched = true;
    this.changed();
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.touched = true;
    if (this.following && Math.hypot(dx, dy) > 0) this.following = false;
    this.changed();
  }

  listen() {
    const canvas = this.canvas, pointers = this.pointers;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const step = event.deltaMode === 1 ? 30 * event.deltaY : event.deltaY;
      this.zoom(Math.exp(-0.0016 * Math.max(-300, Math.min(300, step))), event.clientX, event.clientY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.classList.add("moving");
    });
    const end = (event) => {
      pointers.delete(event.pointerId);
      if (!pointers.size) canvas.classList.remove("moving");
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("dblclick", (event) => this.zoom(2, event.clientX, event.clientY));
  }

  // One pointer drags, two pinch.
  move(event) {
    const pointers = this.pointers;
    if (!pointers.has(event.pointerId)) return;
    const before = [...pointers.values()].map((p) => [...p]);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const after = [...pointers.values()];
    const middle = (p) => [p.reduce((s, q) => s + q[0], 0) / p.length, p.reduce((s, q) => s + q[1], 0) / p.length];
    const [from, to] = [middle(before), middle(after)];
    if (after.length === 2) {
      const apart = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]) || 1;
      this.zoom(apart(after) / apart(before), to[0], to[1]);
    }
    if (to[0] !== from[0] || to[1] !== from[1]) this.pan(to[0] - from[0], to[1] - from[1]);
  }
}

const clamp = (scale) => Math.max(LEAST, Math.min(MOST, scale));
