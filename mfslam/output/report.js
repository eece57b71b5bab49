"use strict";
const map = document.getElementById("map");
const where = document.getElementById("where");
const home = map.viewBox.baseVal;
let box = { x: home.x, y: home.y, w: home.width, h: home.height };
const whole = { ...box };
const scale = document.getElementById("scale");
const show = () => {
  map.setAttribute("viewBox", `${box.x} ${box.y} ${box.w} ${box.h}`);
  const pixelsPerMetre = map.getScreenCTM().a;
  const power = 10 ** Math.floor(Math.log10(140 / pixelsPerMetre));
  const metres = [5, 2, 1].map((m) => m * power).find((m) => m * pixelsPerMetre <= 140);
  scale.textContent = metres < 1 ? `${Math.round(metres * 100)} cm` : `${metres} m`;
  scale.style.width = `${metres * pixelsPerMetre}px`;
};
const at = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());

for (const input of document.querySelectorAll(".map input")) {
  const apply = () => map.classList.toggle("hide-" + input.value, !input.checked);
  input.addEventListener("change", apply);
  apply();
}
map.addEventListener("wheel", (event) => {
  event.preventDefault();
  const p = at(event);
  const k = Math.exp(event.deltaY * 0.0015);
  box = { x: p.x + (box.x - p.x) * k, y: p.y + (box.y - p.y) * k, w: box.w * k, h: box.h * k };
  show();
}, { passive: false });
let grabbed = null;
map.addEventListener("pointerdown", (event) => { grabbed = at(event); map.setPointerCapture(event.pointerId); });
map.addEventListener("pointerup", () => { grabbed = null; });
map.addEventListener("pointermove", (event) => {
  const p = at(event);
  where.textContent = `x ${p.x.toFixed(2)} m, y ${(-p.y).toFixed(2)} m`;
  if (grabbed) {
    box.x += grabbed.x - p.x;
    box.y += grabbed.y - p.y;
    show();
  }
});
document.getElementById("whole").addEventListener("click", () => { box = { ...whole }; show(); });
window.addEventListener("resize", show);
show();
