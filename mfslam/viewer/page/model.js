// What is known of robot, trajectory and loops; the map is in tiles.js. Filled by the stream of events.

const SCAN_STEP_M = 0.005; // as snapshot.py tells it

export class Model {
  constructor() {
    this.robot = null;
    this.speed = null;
    this.scan = new Float32Array(0);
    this.path = new Float64Array(0); // x, y, x, y, ...
    this.pathShown = 0;
    this.keyframes = this.path;
    this.keyframesShown = 0;
    this.loops = new Int32Array(0);
    this.poses = 0; // how many have come
  }

  takeRobot(robot) {
    const before = this.robot;
    this.robot = robot;
    this.poses++;
    const [x, y] = robot.pose, steps = decode(robot.scan, Int16Array);
    this.scan = Float32Array.from(steps, (v, k) => v * SCAN_STEP_M + (k % 2 ? y : x));
    const seconds = before ? robot.stamp_s - before.stamp_s : 0;
    if (seconds > 0 && seconds < 2) {
      const speed = Math.hypot(x - before.pose[0], y - before.pose[1]) / seconds;
      this.speed = this.speed === null ? speed : this.speed + 0.2 * (speed - this.speed);
    }
  }

  takePath(news) {
    this.keyframes = this.path = Float64Array.from(spliced(this.keyframes, news, Int32Array, 1e-3));
    this.keyframesShown = this.pathShown = this.path.length / 2;
  }

  takeLoops(news) {
    this.loops = Int32Array.from(spliced(this.loops, news, Int32Array, 1));
  }
}

// Rows of two, kept up to row ``from``, new from there on.
function spliced(old, { from, rows }, kind, unit) {
  return [...old.subarray(0, 2 * from), ...Array.from(decode(rows, kind), (v) => v * unit)];
}

// An array from the base64 of its bytes (little endian, as is every machine that has a browser).
export function decode(text, kind) {
  return new kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}
