// The traces: all panels share the time axis. Drawing costs the same at every zoom, since each
// pixel column takes its extremes from a pyramid of spans 16 times as long from level to level.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("traces").textContent);
  const viewer = document.getElementById("viewer");
  const LEFT = 58, RIGHT = 10, TOP = 20, AXIS = 20, NAN = -32768, FACTOR = 16;
  // The waveform within the periods is drawn below this many periods in view.
  const CLOSE = 250;
  // Width at which the traces are drawn for print (CSS pixels): all of them fit on one page.
  const PAGE = 860;

  // --- Data ---

  function unpack(part) {
    const text = atob(part.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const values = new Int16Array(bytes.buffer);
    part.data = null;
    // Level 0 of the pyramid: lowest and highest of each span; a value is its own span.
    part.low0 = part.pairs ? every(values, 0) : values;
    part.high0 = part.pairs ? every(values, 1) : values;
    part.n = part.low0.length;
    part.t1 = part.t0 + part.n * part.dt;
    part.levels = [[part.low0, part.high0]];
    while (part.levels[part.levels.length - 1][0].length > FACTOR) {
      const [low, high] = part.levels[part.levels.length - 1];
      const n = Math.ceil(low.length / FACTOR);
      const lows = new Int16Array(n), highs = new Int16Array(n);
      for (let k = 0; k < n; k++) {
        const [a, b] = extremes(low, high, k * FACTOR, Math.min(low.length, (k + 1) * FACTOR));
        lows[k] = a; highs[k] = b;
      }
      part.levels.push([lows, highs]);
    }
  }

  function every(values, offset) {
    const half = new Int16Array(values.length / 2);
    for (let k = 0; k < half.length; k++) half[k] = values[2 * k + offset];
    return half;
  }

  function extremes(low, high, begin, end) {
    let a = 32767, b = NAN;
    for (let k = begin; k < end; k++) {
      if (low[k] === NAN) continue;
      if (low[k] < a) a = low[k];
      if (high[k] > b) b = high[k];
    }
    return b === NAN ? [NAN, NAN] : [a, b];
  }

  // Extremes of the values from index `begin` to `end`, in few steps through the pyramid.
  function range(part, begin, end) {
    let a = 32767, b = NAN, level = 0;
    const take = (from, to) => {
      const [low, high] = part.levels[level];
      const [x, y] = extremes(low, high, from, to);
      if (y !== NAN) { if (x < a) a = x; if (y > b) b = y; }
    };
    while (end > begin) {
      if (level + 1 >= part.levels.length || end - begin < 2 * FACTOR) { take(begin, end); break; }
      const up = Math.ceil(begin / FACTOR) * FACTOR, down = Math.floor(end / FACTOR) * FACTOR;
      take(begin, Math.min(up, end));
      take(Math.max(down, begin), end);
      begin = up / FACTOR; end = down / FACTOR; level++;
    }
    return b === NAN ? null : [a, b];
  }

  for (const panel of data.panels) for (const s of panel.series) s.parts.forEach(unpack);

  // The finest part that holds all that is in view, else the one that holds most.
  function choose(series, from, to) {
    let best = series.parts[0];
    for (const part of series.parts.slice(1)) if (part.t0 <= from && part.t1 >= to) best = part;
    return best;
  }

  // --- View ---

  const view = { from: data.span[0], to: data.span[1] };
  const hidden = new Set();
  let cursor = null, pending = false, onPaper = false;

  function show(from, to) {
    const [first, last] = data.span;
    let width = Math.min(Math.max(to - from, 2 * data.period), last - first);
    from = Math.min(Math.max(from, first), last - width);
    view.from = from; view.to = from + width;
    draw();
  }
  function zoom(factor, at) {
    const t = at === undefined ? (view.from + view.to) / 2 : at;
    show(t - (t - view.from) * factor, t + (view.to - t) * factor);
  }
  function around(width) {
    // Keep what is looked at: the cursor, else the middle; from afar, the begin of the window.
    let t = cursor === null ? (view.from + view.to) / 2 : cursor;
    if (view.to - view.from > 0.9 * (data.span[1] - data.span[0]) && cursor === null) {
      t = data.window[0] + width / 2;
    }
    show(t - width / 2, t + width / 2);
  }

  // --- Page ---

  const holder = viewer.querySelector(".panels");
  const panels = data.panels.map((panel, n) => {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-label", panel.title);
    holder.appendChild(canvas);
    return { ...panel, canvas, last: n === data.panels.length - 1 };
  });
  const legend = viewer.querySelector(".legend");
  data.runs.forEach((run) => {
    const button = document.createElement("button");
    const key = document.createElement("span");
    key.className = "key run" + run.colour;
    key.textContent = run.mark;
    button.type = "button";
    button.append(key, run.label);
    button.setAttribute("aria-pressed", "true");
    button.onclick = () => {
      hidden.has(run.n) ? hidden.delete(run.n) : hidden.add(run.n);
      button.setAttribute("aria-pressed", String(!hidden.has(run.n)));
      draw();
    };
    legend.appendChild(button);
  });

  const actions = {
    all: () => show(...data.span),
    window: () => show(...data.window),
    electrical: () => around(2 * (data.electrical || 0.02)),
    pwm: () => around(10 * data.period),
    in: () => zoom(0.5),
    out: () => zoom(2),
  };
  viewer.querySelectorAll("[data-view]").forEach((button) => {
    button.onclick = actions[button.dataset.view];
  });

  // --- Drawing ---

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const get = (name) => style.getPropertyValue(name).trim();
    return {
      ink: get("--ink"), soft: get("--soft"), line: get("--line"), tint: get("--tint"),
      paper: get("--paper"), run: data.runs.map((run) => get("--run" + run.colour)),
    };
  }

  function steps(from, to, count) {
    const raw = (to - from) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) || 10 * power;
    const ticks = [];
    for (let k = Math.ceil(from / step - 1e-9); k * step <= to + step * 1e-9; k++) ticks.push(k * step);
    return { ticks, step };
  }
  const digits = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));

  function draw() {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; panels.forEach(drawPanel); });
  }

  function visible(panel) {
    const close = (view.to - view.from) / data.period < CLOSE;
    const list = [];
    for (const s of panel.series) {
      if (hidden.has(s.run) || (s.fine && !close)) continue;
      const part = choose(s, view.from, view.to);
      const begin = Math.max(0, Math.floor((view.from - part.t0) / part.dt) - 1);
      const end = Math.min(part.n, Math.ceil((view.to - part.t0) / part.dt) + 2);
      if (end - begin < 1) continue;
      const found = range(part, begin, end);
      if (found === null) continue;
      list.push({ s, part, begin, end, close, found });
    }
    return list;
  }

  const scaled = (part, whole) => part.low + (whole + 32767) * part.scale;

  function drawPanel(panel) {
    const canvas = panel.canvas, ratio = onPaper ? 3 : window.devicePixelRatio || 1;
    const width = onPaper ? PAGE : holder.clientWidth, small = width < 560;
    const plot = small ? 96 : 112, height = TOP + plot + (panel.last ? AXIS : 4);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
      canvas.style.height = height + "px";
    }
    const c = canvas.getContext("2d"), colour = colours();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    const left = LEFT, right = width - RIGHT, top = TOP, bottom = TOP + plot;
    const X = (t) => left + (t - view.from) / (view.to - view.from) * (right - left);

    const list = visible(panel);
    let low = Infinity, high = -Infinity;
    for (const { part, found } of list) {
      low = Math.min(low, scaled(part, found[0])); high = Math.max(high, scaled(part, found[1]));
    }
    if (!(high >= low)) { low = -1; high = 1; }
    let pad = 0.08 * (high - low);
    if (!(pad > 0)) pad = Math.max(1e-3, 0.05 * Math.abs(high));
    low -= pad; high += pad;
    const Y = (v) => bottom - (v - low) / (high - low) * (bottom - top);

    // Evaluation window, grid, axes.
    const w0 = Math.max(left, X(data.window[0])), w1 = Math.min(right, X(data.window[1]));
    c.fillStyle = colour.tint;
    if (w1 > w0) c.fillRect(w0, top, w1 - w0, bottom - top);
    c.font = "11px system-ui, sans-serif";
    c.lineWidth = 1;
    c.strokeStyle = colour.line;
    c.fillStyle = colour.soft;
    const y = steps(low, high, 5), x = steps(view.from, view.to, small ? 4 : 8);
    c.textAlign = "right"; c.textBaseline = "middle";
    for (const v of y.ticks) {
      line(c, left, Y(v), right, Y(v));
      c.fillText(v.toFixed(digits(y.step)), left - 6, Y(v));
    }
    c.textAlign = "center"; c.textBaseline = "top";
    const milli = view.to - view.from < 0.05;
    for (const t of x.ticks) {
      line(c, X(t), top, X(t), bottom);
      if (panel.last) {
        const shown = milli ? (t * 1e3).toFixed(digits(x.step * 1e3)) : t.toFixed(digits(x.step));
        c.fillText(shown, Math.min(Math.max(X(t), left + 12), right - 16), bottom + 5);
      }
    }
    if (panel.last) { c.textAlign = "left"; c.fillText(milli ? "ms" : "s", left - 24, bottom + 5); }

    c.save();
    c.beginPath(); c.rect(left, top, right - left, bottom - top); c.clip();
    for (const item of list) drawSeries(c, item, X, Y, colour, left, right);
    c.restore();

    // Title, and the values under the cursor.
    c.textAlign = "left"; c.textBaseline = "middle"; c.fillStyle = colour.ink;
    c.font = "600 12px system-ui, sans-serif";
    const title = panel.title + " (" + panel.unit + ")";
    c.fillText(title, left, TOP / 2);
    if (cursor !== null && cursor >= view.from && cursor <= view.to) {
      c.strokeStyle = colour.soft; c.setLineDash([2, 3]);
      line(c, X(cursor), top, X(cursor), bottom);
      c.setLineDash([]);
      let at = left + c.measureText(title).width + 14;
      c.font = "11px system-ui, sans-serif";
      const close = digits((high - low) / 1000);
      for (const { s, part } of list) {
        if (s.dash || (s.fine && list.some((o) => o.s.run === s.run && !o.s.fine))) continue;
        const k = Math.floor((cursor - part.t0) / part.dt + 1e-6);
        if (k < 0 || k >= part.n || part.low0[k] === NAN) continue;
        const text = data.runs[s.run].mark + " " + scaled(part, part.high0[k]).toFixed(Math.min(4, close));
        if (at + c.measureText(text).width > right) break;
        c.fillStyle = colour.run[s.run];
        c.fillText(text, at, TOP / 2);
        at += c.measureText(text).width + 10;
      }
      if (panel === panels[0]) {
        c.textAlign = "right"; c.fillStyle = colour.soft;
        const k = Math.floor(cursor / data.period + 1e-6);
        const text = (cursor * 1e3).toFixed(3) + " ms, period " + k;
        if (at + c.measureText(text).width < right) c.fillText(text, right, TOP / 2);
      }
    }
  }

  function line(c, x0, y0, x1, y1) {
    c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke();
  }

  function drawSeries(c, { s, part, begin, end, close }, X, Y, colour, left, right) {
    const ink = colour.run[s.run];
    c.strokeStyle = c.fillStyle = ink;
    c.globalAlpha = s.dash ? 0.9 : 1;
    c.lineWidth = s.dash ? 1 : s.fine ? 1 : 1.2;
    c.setLineDash(s.dash ? [6, 4] : []);
    const perPixel = (view.to - view.from) / part.dt / (right - left);
    const value = (whole) => Y(scaled(part, whole));
    c.beginPath();
    if (perPixel > 2 || part.pairs) {
      let pen = false;
      const wide = Math.max(1, part.pairs ? 1 / perPixel : 1);
      for (let x = left; x < right; x += wide) {
        const t = view.from + (x - left) / (right - left) * (view.to - view.from);
        const from = Math.max(begin, Math.floor((t - part.t0) / part.dt));
        const to = Math.min(end, Math.max(from + 1, Math.floor((t - part.t0) / part.dt + perPixel * wide) + 1));
        const found = to > from ? range(part, from, to) : null;
        if (found === null) { pen = false; continue; }
        const a = value(found[0]), b = value(found[1]);
        pen ? c.lineTo(x, a) : c.moveTo(x, a);
        c.lineTo(x, Math.abs(b - a) < 0.5 ? a + 0.5 : b);
        pen = true;
      }
      c.stroke();
    } else {
      // Close up, samples are dots beside the waveform within the periods; alone, they are joined.
      const spacing = 1 / perPixel;
      const waveform = close && !s.fine && !s.dash && hasFine(s);
      let pen = false;
      for (let k = begin; k < end; k++) {
        const whole = part.low0[k];
        if (whole === NAN) { pen = false; continue; }
        const x = X(part.t0 + k * part.dt), y = value(whole);
        if (pen) { if (s.dash) c.lineTo(x, c.lastY); c.lineTo(x, y); } else c.moveTo(x, y);
        c.lastY = y; pen = true;
      }
      if (!waveform) c.stroke();
      if (!s.dash && !s.fine && (waveform || spacing > 7)) {
        mark(c, s.run, spacing > 7 ? 9 : 6, function* () {
          for (let k = begin; k < end; k++) {
            if (part.low0[k] !== NAN) yield [X(part.t0 + k * part.dt), value(part.low0[k])];
          }
        });
      }
    }
    if (!s.dash && !s.fine && data.runs.length > 1 && 1 / perPixel <= 7) {
      // Far out, a mark here and there tells whose line it is, without its colour.
      mark(c, s.run, 9, function* () {
        const apart = 120, first = left + apart * (0.3 + s.run / data.runs.length);
        for (let x = first; x < right; x += apart) {
          const k = Math.round((view.from + (x - left) / (right - left) * (view.to - view.from) - part.t0) / part.dt);
          if (k >= begin && k < end && part.low0[k] !== NAN) yield [X(part.t0 + k * part.dt), value(part.low0[k])];
        }
      });
    }
    c.globalAlpha = 1;
    c.setLineDash([]);
  }

  function mark(c, run, size, places) {
    c.font = size + "px system-ui, sans-serif";
    c.textAlign = "center"; c.textBaseline = "middle";
    for (const [x, y] of places()) c.fillText(data.runs[run].mark, x, y);
  }

  // Whether the waveform within the periods covers the view, for a series of samples.
  function hasFine(series) {
    return panels.some((panel) => panel.series.includes(series) && panel.series.some((s) =>
      s.fine && s.run === series.run && s.parts[0].t0 <= view.from + data.period &&
      s.parts[0].t1 >= view.to - data.period));
  }

  // --- Input ---

  const pointers = new Map();
  const time = (canvas, x) => {
    const box = canvas.getBoundingClientRect();
    const share = (x - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return view.from + share * (view.to - view.from);
  };
  for (const { canvas } of panels) {
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      pointers.set(e.pointerId, e.clientX);
      viewer.focus({ preventScroll: true });
      cursor = time(canvas, e.clientX); draw();
    });
    canvas.addEventListener("pointermove", (e) => {
      const plot = canvas.clientWidth - LEFT - RIGHT, before = pointers.get(e.pointerId);
      if (before === undefined) { cursor = time(canvas, e.clientX); draw(); return; }
      const others = [...pointers].filter(([id]) => id !== e.pointerId);
      pointers.set(e.pointerId, e.clientX);
      if (others.length === 0) {
        const shift = (before - e.clientX) / plot * (view.to - view.from);
        show(view.from + shift, view.to + shift);
      } else {
        const other = others[0][1], old = Math.abs(before - other), now = Math.abs(e.clientX - other);
        if (old > 4 && now > 4) zoom(old / now, time(canvas, (e.clientX + other) / 2));
      }
    });
    for (const kind of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(kind, (e) => pointers.delete(e.pointerId));
    }
    canvas.addEventListener("pointerleave", (e) => {
      if (e.pointerType === "mouse" && pointers.size === 0) { cursor = null; draw(); }
    });
    canvas.addEventListener("dblclick", actions.all);
    canvas.addEventListener("wheel", (e) => {
      const sideways = Math.abs(e.deltaX) > Math.abs(e.deltaY);
      if (!(e.ctrlKey || e.metaKey || sideways || document.activeElement === viewer)) return;
      e.preventDefault();
      if (sideways) {
        const shift = e.deltaX / canvas.clientWidth * (view.to - view.from);
        show(view.from + shift, view.to + shift);
      } else {
        const lines = e.deltaMode === 1 ? 16 : 1;
        zoom(Math.exp(Math.max(-120, Math.min(120, e.deltaY * lines)) * 0.004), time(canvas, e.clientX));
      }
    }, { passive: false });
  }
  viewer.addEventListener("keydown", (e) => {
    const width = view.to - view.from;
    const keys = {
      ArrowLeft: () => show(view.from - 0.2 * width, view.to - 0.2 * width),
      ArrowRight: () => show(view.from + 0.2 * width, view.to + 0.2 * width),
      "+": actions.in, "=": actions.in, "-": actions.out, Home: actions.all,
    };
    if (e.target === viewer && keys[e.key]) { e.preventDefault(); keys[e.key](); }
  });
  new ResizeObserver(draw).observe(holder);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();

  // --- Print: what is in view, in ink on white and sharp, and the configuration unfolded ---

  let folded = [];
  function paper(on) {
    if (on === onPaper) return;
    onPaper = on;
    document.documentElement.classList.toggle("printing", on);
    if (on) folded = [...document.querySelectorAll("details:not([open])")];
    for (const details of folded) details.open = on;
    panels.forEach(drawPanel);
  }
  window.addEventListener("beforeprint", () => paper(true));
  window.addEventListener("afterprint", () => paper(false));

  // --- What is wider than the screen says so ---

  for (const box of document.querySelectorAll(".scroll")) {
    const hint = document.createElement("p");
    hint.className = "hint";
    hint.textContent = "Scroll sideways for the rest \u2192";
    box.before(hint);
    const look = () => {
      hint.hidden = box.scrollWidth <= box.clientWidth + 1;
      box.classList.toggle("more", box.scrollLeft + box.clientWidth < box.scrollWidth - 1);
    };
    new ResizeObserver(look).observe(box);
    box.addEventListener("scroll", look, { passive: true });
    box.querySelectorAll("img").forEach((img) => img.addEventListener("load", look));
    look();
  }

  // For tests: what is in view, and how long a frame takes.
  window.traces = {
    view, show,
    frame: () => { const t = performance.now(); panels.forEach(drawPanel); return performance.now() - t; },
  };
})();
