// The stream of events: taken up again when it breaks, and let go while nobody looks.

const SILENT_MS = 5000, STALE_MS = 2500;

export class Stream {
  constructor(on) {
    this.on = on; // {hello, news, link}
    this.stream = null;
    this.heardMs = this.movedMs = performance.now();
    this.over = null;
    this.last = false;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.close() : this.open()));
    setInterval(() => this.watch(), 500);
    this.open();
  }

  open() {
    this.close();
    this.heardMs = performance.now();
    this.stream = new EventSource("events");
    this.stream.onmessage = (event) => this.take(JSON.parse(event.data));
  }

  close() {
    this.stream?.close();
    this.stream = null;
  }

  take(message) {
    this.heardMs = performance.now();
    if (message.hello) {
      this.over = null;
      this.last = false;
      this.mode = message.hello.mode;
      this.on.hello(message.hello);
      return;
    }
    if (message.robot) this.movedMs = this.heardMs;
    this.over = message.over ?? null;
    this.last = message.last ?? false; // no more will be said
    this.on.news(message);
    this.watch();
  }

  // Say how the connection fares, or how the run ended; a stream that is dead without saying so is begun anew.
  watch() {
    const now = performance.now(), silent = now - this.heardMs, still = now - this.movedMs;
    if (!this.stream) return;
    const closed = this.stream.readyState === EventSource.CLOSED || silent > 4 * SILENT_MS;
    if (closed && silent > SILENT_MS) this.open();
    const lost = closed || this.stream.readyState === EventSource.CONNECTING || silent > SILENT_MS;
    if (lost && !this.last) {
      this.on.link("no connection: trying again", "bad");
    } else if (this.over) {
      this.on.link(this.over, "wait");
    } else if (this.mode === "run") {
      this.on.link("finished run", "wait");
    } else if (still > STALE_MS) {
      this.on.link(this.on.begun() ? `no scan for ${(still / 1000).toFixed(0)} s` : "waiting for the first scan", "warn");
    } else {
      this.on.link("live", "good");
    }
  }
}
