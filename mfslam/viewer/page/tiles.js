// The map's tiles: fetched when they have changed, coloured as the theme has it, thinned for far views so that walls stay.

const AT_ONCE = 4;
const FREE = 1, OCCUPIED = 2;

export class Tiles {
  constructor(changed) {
    this.changed = changed;
    this.tiles = new Map(); // name -> {col, row, version, wanted, cells, seen, images}
    this.resolution = 0.05;
    this.offset = [0, 0];
    this.size = 256;
    this.now = 65535; // cells that were first seen later are not shown
    this.fetching = 0;
    this.loaded = 0;
    this.renewed = false;
  }

  // A server that was restarted counts versions anew: what we have is shown until the new is there.
  reconnected() { this.renewed = true; }

  take(news) {
    if (news.resolution_m !== this.resolution || news.offset_m.some((v, k) => v !== this.offset[k])) this.tiles.clear();
    [this.resolution, this.offset, this.size] = [news.resolution_m, news.offset_m, news.tile_cells];
    if (this.renewed) {
      for (const name of this.tiles.keys()) if (!(name in news.tiles)) this.tiles.delete(name);
      for (const tile of this.tiles.values()) tile.version = -1;
      this.renewed = false;
    }
    for (const name of news.gone) this.tiles.delete(name);
    for (const [name, version] of Object.entries(news.tiles)) {
      const [col, row] = name.split("_").map(Number);
      const tile = this.tiles.get(name) ?? { name, col, row, version: -1, cells: null, seen: null, images: [] };
      tile.wanted = version;
      this.tiles.set(name, tile);
    }
    this.fetchSome();
    this.changed();
  }

  async fetchSome() {
    while (this.fetching < AT_ONCE) {
      const tile = [...this.tiles.values()].find((t) => t.version !== t.wanted && !t.busy);
      if (!tile) return;
      this.fetching++;
      tile.busy = true;
      this.fetchOne(tile).finally(() => {
        this.fetching--;
        tile.busy = false;
        this.fetchSome();
      });
    }
  }

  async fetchOne(tile) {
    const version = tile.wanted;
    try {
      const reply = await fetch(`tiles/${tile.name}?v=${version}`);
      if (reply.ok) {
        const data = new Uint8Array(await reply.arrayBuffer());
        const n = this.size * this.size;
        tile.cells = data.subarray(0, n);
        tile.seen = data.length >= 3 * n ? new Uint16Array(data.buffer, data.byteOffset + n, n) : null;
        tile.images = [];
        this.loaded++;
        this.changed();
      }
    } catch {
      // the stream of events notices that the server is gone, and brings new versions when it is back
      await new Promise((wake) => setTimeout(wake, 1000));
    }
    tile.version = version;
  }

  // Show only what was seen by an instant of a finished run, 0 to 65535.
  showUntil(now) {
    if (now === this.now) return;
    const [from, to] = [Math.min(now, this.now), Math.max(now, this.now)];
    this.now = now;
    for (const tile of this.tiles.values()) if (tile.seen && changesBetween(tile, from, to)) tile.images = [];
    this.changed();
  }

  recolour() {
    for (const tile of this.tiles.values()) tile.images = [];
    this.changed();
  }

  // The known part of the world: left, low, right, top; null where there is none.
  box() {
    const all = [...this.tiles.values()].filter((t) => t.cells);
    if (!all.length) return null;
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const tile of all) {
      tile.known ??= extent(tile.cells, this.size);
      const [x, y] = [tile.col * this.size, tile.row * this.size];
      box[0] = Math.min(box[0], x + tile.known[0]);
      box[1] = Math.min(box[1], y + tile.known[1]);
      box[2] = Math.max(box[2], x + tile.known[2]);
      box[3] = Math.max(box[3], y + tile.known[3]);
    }
    return box.map((v, k) => v * this.resolution + this.offset[k % 2]);
  }

  draw(ctx, camera, colours) {
    const side = this.size * this.resolution;
    const [left, low, right, top] = camera.box();
    const perCell = camera.scale * devicePixelRatio * this.resolution;
    const level = perCell >= 0.75 ? 0 : perCell >= 0.375 ? 1 : 2;
    ctx.imageSmoothingEnabled = perCell * 2 ** level < 1;
    let drawn = 0;
    for (const tile of this.tiles.values()) {
      const x = tile.col * side + this.offset[0], y = tile.row * side + this.offset[1];
      if (!tile.cells || x > right || y > top || x + side < left || y + side < low) continue;
      tile.images[level] ??= this.paint(tile, level, colours);
      ctx.drawImage(tile.images[level], x, y, side, side);
      drawn++;
    }
    return drawn;
  }

  // One pixel for 4^level cells: occupied if one of them is, else free if one is.
  paint(tile, level, colours) {
    const step = 2 ** level, n = this.size / step;
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = n;
    const ctx = canvas.getContext("2d");
    const image = ctx.createImageData(n, n), pixels = new Uint32Array(image.data.buffer);
    const colour = [0, colours.free, colours.wall];
    const { cells, seen } = tile, { size, now } = this;
    for (let row = 0; row < size; row++) {
      for (let col = 0, at = row * size, out = (row >> level) * n; col < size; col++, at++) {
        const kind = cells[at];
        if (kind === 0 || (seen && seen[at] > now)) continue;
        const pixel = out + (col >> level);
        if (kind === OCCUPIED || pixels[pixel] === 0) pixels[pixel] = colour[kind === FREE ? FREE : OCCUPIED];
      }
    }
    ctx.putImageData(image, 0, 0);
    return canvas;
  }
}

function changesBetween(tile, from, to) {
  if (tile.span?.seen !== tile.seen) {
    let [least, most] = [65535, 0];
    for (let k = 0; k < tile.seen.length; k++) {
      if (!tile.cells[k]) continue;
      if (tile.seen[k] < least) least = tile.seen[k];
      if (tile.seen[k] > most) most = tile.seen[k];
    }
    tile.span = { seen: tile.seen, least, most };
  }
  return tile.span.most > from && tile.span.least <= to;
}

function extent(cells, size) {
  let [left, low, right, top] = [size, size, 0, 0];
  for (let row = 0, at = 0; row < size; row++) {
    for (let col = 0; col < size; col++, at++) {
      if (!cells[at]) continue;
      if (col < left) left = col;
      if (col >= right) right = col + 1;
      if (row < low) low = row;
      if (row >= top) top = row + 1;
    }
  }
  return [left, low, right, top];
}
