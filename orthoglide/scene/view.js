"use strict";
/* One machine a view: a canvas that is turned by dragging, drawn far things first. */
for (const view of document.querySelectorAll("div.view:not([data-ready])")) {
  view.dataset.ready = "1";
  view.hidden = false;
  const data = JSON.parse(view.querySelector("script").textContent);
  const canvas = view.querySelector("canvas"), pen = canvas.getContext("2d");
  const place = view.querySelector(".place"), times = view.querySelector(".times");
  const play = view.querySelector(".play"), readout = view.querySelector(".readout");
  const ways = [...view.querySelectorAll(".way")];
  const count = data.frames.length, tool = 36;
  let turn = data.hanging ? -1.0 : 0.9, tilt = data.hanging ? 0.38 : 0.52, zoom = 1, moving = false;

  const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
  const mean = (a, b) => add(a, add(b, a, -1), 0.5);
  const length = a => Math.hypot(...a);

  /* All points of a posture in millimetres, between two of the postures given. */
  function posture(at) {
    const low = Math.min(Math.floor(at), count - 1), high = Math.min(low + 1, count - 1), part = at - low;
    const on = ways.filter(w => w.checked).map(w => data.ways[+w.value].moved);
    const by = +times.value, found = new Array(39), error = [0, 0, 0];
    for (let k = 0; k < 39; k++) {
      let moved = 0;
      for (const one of on) moved += (one[low][k] * (1 - part) + one[high][k] * part) / 1e4;
      if (k >= tool) error[k - tool] = moved;
      found[k] = (data.frames[low][k] * (1 - part) + data.frames[high][k] * part) / 100 + by * moved;
    }
    const point = k => found.slice(3 * k, 3 * k + 3);
    return { end: (leg, bar, end) => point(4 * leg + 2 * bar + end), p: point(12), error };
  }

  const all = [];
  for (let leg = 0; leg < 3; leg++) for (const s of data.stroke)
    all.push(add(data.carriage[leg], data.axes[leg][0], s + Math.sign(s) * data.d));
  for (const f of data.frames) all.push([f[tool] / 100, f[tool + 1] / 100, f[tool + 2] / 100]);
  const middle = [0, 1, 2].map(k => (Math.min(...all.map(p => p[k])) + Math.max(...all.map(p => p[k]))) / 2);
  const reach = Math.max(...all.map(p => length(add(p, middle, -1))));

  function projector() {
    const [ct, st, ci, si] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    const scale = zoom * 0.45 * Math.min(canvas.width, canvas.height) / reach;
    return p => {
      const q = add(p, middle, -1);
      const x = -st * q[0] + ct * q[1], y = -ct * si * q[0] - st * si * q[1] + ci * q[2];
      return [canvas.width / 2 + scale * x, canvas.height / 2 - scale * y, ct * ci * q[0] + st * ci * q[1] + si * q[2]];
    };
  }

  function draw() {
    const wide = Math.min(devicePixelRatio || 1, 2);
    canvas.width = Math.round(canvas.clientWidth * wide); canvas.height = Math.round(canvas.clientHeight * wide);
    const to = projector(), now = posture(+place.value), bodies = [];
    const line = (a, b, colour, width, near = 0) => {
      const [u, v] = [to(a), to(b)];
      bodies.push([(u[2] + v[2]) / 2 + near, () => {
        pen.strokeStyle = colour; pen.lineWidth = width * wide; pen.lineCap = "round";
        pen.beginPath(); pen.moveTo(u[0], u[1]); pen.lineTo(v[0], v[1]); pen.stroke();
      }]);
    };
    const face = (corners, colour) => {
      const seen = corners.map(to), depth = seen.reduce((s, c) => s + c[2], 0) / seen.length;
      bodies.push([depth, () => {
        pen.fillStyle = colour; pen.strokeStyle = "#7b8790"; pen.lineWidth = 0.7 * wide;
        pen.beginPath(); seen.forEach((c, k) => k ? pen.lineTo(c[0], c[1]) : pen.moveTo(c[0], c[1]));
        pen.closePath(); pen.fill(); pen.stroke();
      }]);
    };
    const box = (centre, axes, half, colours) => {
      for (let k = 0; k < 3; k++) for (const side of [1, -1]) {
        const m = add(centre, axes[k], side * half[k]), [i, j] = [(k + 1) % 3, (k + 2) % 3];
        face([[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([u, v]) =>
          add(add(m, axes[i], u * half[i]), axes[j], v * half[j])), colours[Math.abs(axes[k][2]) > 0.7 ? 0 : 1]);
      }
    };
    const corners = [];
    for (let leg = 0; leg < 3; leg++) {
      const axes = data.axes[leg], d = data.d, [low, high] = data.stroke;
      const rail = add(add(data.carriage[leg], axes[0], (low + high) / 2), axes[1], 0.5 * d);
      box(rail, axes, [(high - low) / 2 + 0.6 * d, 0.12 * d, 0.16 * d], ["#b4bec6", "#98a4ad"]);
      const at = mean(now.end(leg, 0, 0), now.end(leg, 1, 0));
      box(add(at, axes[1], 0.2 * d), axes, [0.34 * d, 0.2 * d, 0.42 * d], ["#dbe1e6", "#c3ccd3"]);
      for (const bar of [0, 1]) line(now.end(leg, bar, 0), now.end(leg, bar, 1), "#5c6872", 4, 1);
      for (const end of [0, 1]) line(now.end(leg, 0, end), now.end(leg, 1, end), "#5c6872", 3, 2);
      corners.push(mean(now.end(leg, 0, 1), now.end(leg, 1, 1)));
    }
    face(corners, "#c3ccd3");
    const centre = [0, 1, 2].map(k => (corners[0][k] + corners[1][k] + corners[2][k]) / 3);
    line(centre, now.p, "#1f2a33", 3, 3);
    const on = ways.filter(w => w.checked).map(w => data.ways[+w.value].moved), by = +times.value;
    if (on.length) for (const [k, f] of data.frames.entries()) {
      const p = [0, 1, 2].map(j => f[tool + j] / 100);
      const e = [0, 1, 2].map(j => on.reduce((s, one) => s + one[k][tool + j] / 1e4, 0));
      line(p, add(p, e, by), "#d55e00", 1.3, 4);
      line(p, p, "#d55e00", 3, 4);
    }
    pen.fillStyle = "#ffffff"; pen.fillRect(0, 0, canvas.width, canvas.height);
    bodies.sort((a, b) => a[0] - b[0]).forEach(b => b[1]());
    pen.fillStyle = "#1f2a33"; pen.font = `600 ${14 * wide}px sans-serif`; pen.textAlign = "center";
    for (let leg = 0; leg < 3; leg++) {
      const [x, y] = to(add(data.carriage[leg], data.axes[leg][0], data.stroke[1] + 1.1 * data.d));
      pen.fillText(data.names[leg], x, y);
    }
    const [x, y] = to(now.p);
    pen.beginPath(); pen.arc(x, y, 4 * wide, 0, 7); pen.fill();
    readout.textContent = `Tool at ${now.p.map((v, k) => (v - by * now.error[k]).toFixed(0)).join(", ")} mm, ` +
      `off by ${now.error.map(v => v.toFixed(3)).join(", ")} mm in x, y, z. Drag to turn; Ctrl and the wheel to come nearer.`;
  }

  function step() {
    if (!moving || !canvas.isConnected) return;
    place.value = (+place.value + 0.04) % (count - 1);
    draw();
    requestAnimationFrame(step);
  }
  play.onclick = () => { moving = !moving; play.textContent = moving ? "stop" : "move"; step(); };
  for (const one of [place, times, ...ways]) one.oninput = draw;
  canvas.onpointermove = e => {
    if (!e.buttons) return;
    turn -= e.movementX / 150; tilt = Math.max(-1.5, Math.min(1.5, tilt + e.movementY / 150)); draw();
  };
  canvas.onpointerdown = e => canvas.setPointerCapture(e.pointerId);
  canvas.addEventListener("wheel", e => { if (!e.ctrlKey) return; e.preventDefault(); zoom *= Math.exp(-e.deltaY / 600); draw(); }, { passive: false });
  addEventListener("resize", draw);
  place.value = Math.floor(count / 2);
  /* The magnification at which what is switched on is seen and the machine still known. */
  const largest = Math.max(1e-6, ...data.ways.slice(0, 1).flatMap(w => w.moved.map(f => length(f.slice(tool)) / 1e4)));
  times.value = ["1000", "300", "100", "10"].find(v => v * largest < 60) || "1";
  draw();
}
