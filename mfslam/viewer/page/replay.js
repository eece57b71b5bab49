// A finished run, played: where the robot was, what it saw, and what of the map was known by then.

const COLUMNS = 8; // t_s, x, y, yaw, xx, xy, yy, yawyaw
const SCANS_AT_ONCE = 128;

export class Replay {
  constructor(model, tiles, changed) {
    [this.model, this.tiles, this.changed] = [model, tiles, changed];
    this.playing = false;
    this.speed = 10;
    this.t = 0;
    this.index = -1;
    this.parts = new Map(); // scans by number of their part: promise, then array of Float32Array
  }

  async load() {
    const part = async (name) => (await fetch(name)).arrayBuffer();
    const [table, keyframes] = await Promise.all([part("trajectory.bin"), part("keyframes.bin")]);
    this.table = new Float32Array(table);
    this.keyframeScans = new Uint32Array(keyframes);
    this.count = this.table.length / COLUMNS;
    this.end = this.count ? this.table[(this.count - 1) * COLUMNS] : 0;
    this.path = new Float64Array(2 * this.count);
    for (let k = 0; k < this.count; k++) {
      this.path[2 * k] = this.table[k * COLUMNS + 1];
      this.path[2 * k + 1] = this.table[k * COLUMNS + 2];
    }
    this.model.path = this.path;
    this.seek(this.end);
  }

  // The last scan that had begun by an instant.
  scanAt(t) {
    let [low, high] = [0, this.count - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.table[middle * COLUMNS] <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  seek(t) {
    this.t = Math.max(0, Math.min(this.end, t));
    if (!this.count) return;
    const index = this.scanAt(this.t);
    if (index !== this.index) this.show(index);
    this.changed();
  }

  show(index) {
    this.index = index;
    const { model, table } = this, row = (n) => table.subarray(n * COLUMNS, (n + 1) * COLUMNS);
    const [t, x, y, yaw, xx, xy, yy, yawyaw] = row(index);
    model.robot = { stamp_s: t, pose: [x, y, yaw], covariance: Number.isNaN(xx) ? null : [xx, xy, 0, yy, 0, yawyaw] };
    const before = row(Math.max(0, index - 3)), seconds = t - before[0];
    model.speed = seconds > 0 ? Math.hypot(x - before[1], y - before[2]) / seconds : null;
    model.poses++;
    model.pathShown = index + 1;
    let shown = 0;
    while (shown < this.keyframeScans.length && this.keyframeScans[shown] <= index) shown++;
    model.keyframesShown = shown;
    const last = index === this.count - 1;
    this.tiles.showUntil(last ? 65535 : 1 + Math.floor((index * 65533) / Math.max(1, this.count - 1)));
    this.showScan(index);
  }

  async showScan(index) {
    const number = Math.floor(index / SCANS_AT_ONCE);
    const part = this.part(number);
    if (this.playing && (number + 1) * SCANS_AT_ONCE < this.count) this.part(number + 1); // what comes next
    const scans = part instanceof Promise ? await part : part;
    if (index !== this.index) return;
    this.model.scan = scans[index - number * SCANS_AT_ONCE] ?? new Float32Array(0);
    this.changed();
  }

  part(number) {
    if (!this.parts.has(number)) {
      const loading = fetch(`scans.bin?first=${number * SCANS_AT_ONCE}&count=${SCANS_AT_ONCE}`)
        .then((reply) => reply.arrayBuffer())
        .then((data) => {
          const scans = split(data);
          this.parts.set(number, scans);
          return scans;
        })
        .catch(() => {
          this.parts.delete(number);
          return [];
        });
      this.parts.set(number, loading);
      if (this.parts.size > 60) this.parts.delete(this.parts.keys().next().value);
    }
    return this.parts.get(number);
  }

  // A frame's time has passed.
  step(seconds) {
    if (!this.playing) return;
    this.seek(this.t + seconds * this.speed);
    if (this.t >= this.end) this.playing = false;
  }

  toggle() {
    if (!this.playing && this.t >= this.end) this.seek(0);
    this.playing = !this.playing;
  }
}

// Counts of points (uint32) with their own count in front, then x, y of all (float32).
function split(data) {
  const [n] = new Uint32Array(data, 0, 1), counts = new Uint32Array(data, 4, n), out = [];
  let at = 4 * (n + 1);
  for (const count of counts) {
    out.push(new Float32Array(data, at, 2 * count));
    at += 8 * count;
  }
  return out;
}
