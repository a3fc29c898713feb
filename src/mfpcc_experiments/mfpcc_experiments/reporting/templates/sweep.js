"use strict";
// The map of a sweep: any two axes, any scheme. All cells are in the page.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const canvas = document.getElementById("map");
  const pick = (id) => document.getElementById(id);
  const fill = (id, names, chosen) => {
    names.forEach((name, n) => pick(id).add(new Option(name, n, n === chosen, n === chosen)));
    pick(id).addEventListener("change", draw);
  };
  // viridis, as in the figures
  const stops = [
    [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
    [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
  ];
  const colour = (share) => {
    const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
    const n = Math.min(Math.floor(at), stops.length - 2);
    const mix = stops[n].map((c, k) => Math.round(c + (at - n) * (stops[n + 1][k] - c)));
    return `rgb(${mix.join(",")})`;
  };
  const short = (v) => Number(v.toPrecision(3)).toString();

  // Cells of the chosen axes, as [x][y]
  function cells(x, y, scheme, shown) {
    const [i, j] = x < y ? [x, y] : [y, x];
    const flat = data.cells[`${i},${j},${scheme},${shown}`];
    const nx = data.axes[x].edges.length - 1, ny = data.axes[y].edges.length - 1;
    return Array.from({ length: nx }, (_, a) =>
      Array.from({ length: ny }, (_, b) => (x < y ? flat[a * ny + b] : flat[b * nx + a])));
  }

  function draw() {
    let x = +pick("x").value;
    const y = +pick("y").value;
    if (x === y) {
      x = (y + 1) % data.axes.length;
      pick("x").value = x;
    }
    const shown = data.shown[+pick("shown").value];
    const share = shown === data.shown[0];
    const scheme = data.schemes[+pick("scheme").value];
    const grid = cells(x, y, scheme, shown);
    // one scale for all schemes
    const all = data.schemes.flatMap((s) => cells(x, y, s, shown).flat())
      .filter((v) => v !== null).sort((a, b) => a - b);
    const low = share ? 0 : all[0] ?? 0;
    const high = share ? 1 : all[Math.floor(0.98 * (all.length - 1))] ?? 1;
    const g = canvas.getContext("2d");
    const [left, top, width, height] = [110, 20, 790, 610];
    const ink = getComputedStyle(document.body).color;
    g.clearRect(0, 0, canvas.width, canvas.height);
    g.font = "22px sans-serif";
    const nx = grid.length, ny = grid[0].length;
    grid.forEach((column, a) => column.forEach((v, b) => {
      if (v === null) return;
      const at = (v - low) / (high - low || 1);
      g.fillStyle = colour(share ? at : 1 - at);
      g.fillRect(left + a * width / nx, top + (ny - 1 - b) * height / ny,
        width / nx + 0.5, height / ny + 0.5);
    }));
    g.fillStyle = ink;
    const ticks = (axis, n, put) => {
      const every = axis.labels.length ? Math.ceil(n / 8) : Math.ceil(n / 6);
      for (let k = 0; k < (axis.labels.length ? n : n + 1); k += every) {
        put(axis.labels.length ? k + 0.5 : k, axis.labels[k] ?? short(axis.edges[k]));
      }
    };
    g.textAlign = "center";
    ticks(data.axes[x], nx, (k, text) => g.fillText(text, left + k * width / nx, top + height + 28));
    g.fillText(data.axes[x].name, left + width / 2, top + height + 62);
    g.textAlign = "right";
    ticks(data.axes[y], ny, (k, text) => g.fillText(text, left - 10, top + height - k * height / ny + 8));
    g.save();
    g.translate(24, top + height / 2);
    g.rotate(-Math.PI / 2);
    g.textAlign = "center";
    g.fillText(data.axes[y].name, 0, 0);
    g.restore();
    // scale
    for (let k = 0; k < 100; k += 1) {
      g.fillStyle = colour(share ? k / 99 : 1 - k / 99);
      g.fillRect(left + width + 30, top + (99 - k) * height / 100, 28, height / 100 + 0.5);
    }
    g.fillStyle = ink;
    g.textAlign = "left";
    for (const part of [0, 0.5, 1]) {
      g.fillText(short(low + part * (high - low)), left + width + 66, top + (1 - part) * height + 8);
    }
    pick("under").textContent = `${scheme}: ${shown}. No colour: no run there, or none that has ` +
      `the figure. Cells are equally wide${data.axes[x].log || data.axes[y].log
        ? " (in the logarithm, where the draws are)" : ""}; the scale is the same for all schemes` +
      `${share ? "." : ", and ends where 98 % of the cells are below."}`;
  }
  fill("x", data.axes.map((a) => a.name), 0);
  fill("y", data.axes.map((a) => a.name), 1);
  fill("shown", data.shown, 0);
  fill("scheme", data.schemes, 0);
  draw();
})();
