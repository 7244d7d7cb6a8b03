/* The page's own script: colour scheme, figures drawn when they come into view, the slider, printing. */
(function () {
  "use strict";
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const DARK_COLORS = JSON.parse(document.getElementById("dark-colors").textContent);
  const NARROW_PX = 600;
  /* Width of a card's drawing on paper [px]: A4 between its margins, at the zoom of the style sheet. */
  const PAPER_PX = { wide: 1034, half: 493 };
  const CONFIG = { displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d"],
    /* Not two pixels for one, as the library does: without a graphics processor that is four times the work. */
    plotGlPixelRatio: Math.min(2, Math.max(1, devicePixelRatio)) };

  /* Compressed texts. */
  function bytesOf(base64) {
    const text = atob(base64), bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    return bytes;
  }
  function inflated(node) {
    const stream = new Blob([bytesOf(node.textContent.trim())]).stream();
    return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).text();
  }
  let library = null;
  function loadLibrary() {
    if (!library) {
      const start = performance.now();
      library = inflated(document.getElementById("plotly")).then(function (text) {
        const script = document.createElement("script"), limit = Error.stackTraceLimit;
        script.textContent = text;
        /* The library makes errors as it starts; where in 5 MB they were made nobody asks, and it takes long to find. */
        Error.stackTraceLimit = 0;
        document.head.append(script);
        Error.stackTraceLimit = limit;
        performance.measure("plotly", { start });
      });
    }
    return library;
  }

  /* Figures. */
  const figures = Array.from(document.querySelectorAll("script.figure"), function (node) {
    const drawing = document.getElementById(node.dataset.target);
    return { node, drawing, plot: drawing.parentElement, text: null, clock: "", width: 0, drawn: false, stale: false, near: false, asked: false, sketched: false, found: null, shape: null, view: null, inView: false, moments: [] };
  });
  const REST_MS = 350;
  const isPrinting = { now: false };
  function isDark() {
    if (isPrinting.now) return false;
    return root.dataset.scheme ? root.dataset.scheme === "dark" : dark.matches;
  }
  function content(figure) {
    let text = figure.text;
    if (isDark()) for (const light in DARK_COLORS) text = text.replaceAll('"' + light, '"' + DARK_COLORS[light]);
    const found = JSON.parse(text), layout = found.layout;
    layout.uirevision = "kept";
    figure.width = figure.plot.clientWidth || NARROW_PX;
    layout.autosize = false;
    layout.width = figure.width;
    if (isPrinting.now) layout.width = figure.plot.closest(".wide") ? PAPER_PX.wide : PAPER_PX.half;
    figure.plot.style.height = layout.height + "px";
    figure.clock = found.clock;
    return found;
  }
  /* A 3D figure until it is touched: its own data on a flat canvas, in the same view. A browser without a graphics
     processor takes seconds for the real one, and milliseconds for this. */
  const ARRAYS = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, i4: Int32Array };
  const FIELD_OF_VIEW_RAD = Math.PI / 4, LIGHT = [0.27, -0.53, 0.8];
  function numbers(value) {
    if (!value) return [];
    return value.bdata ? new ARRAYS[value.dtype](bytesOf(value.bdata).buffer) : value;
  }
  function isSolid(figure) { return figure.node.dataset.kind === "3d"; }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function unit(a) { const length = Math.hypot(a[0], a[1], a[2]) || 1; return [a[0] / length, a[1] / length, a[2] / length]; }
  function colorAt(scale, share) {
    let k = 1;
    while (k < scale.length - 1 && share > scale[k][0]) k++;
    const low = scale[k - 1], high = scale[k], at = Math.min(1, Math.max(0, (share - low[0]) / (high[0] - low[0] || 1)));
    const part = function (color, n) { return parseInt(color.slice(1 + 2 * n, 3 + 2 * n), 16); };
    return [0, 1, 2].map(function (n) { return Math.round(part(low[1], n) + at * (part(high[1], n) - part(low[1], n))); });
  }
  function solidOf(found) {
    const traces = found.data.filter(function (each) { return each.visible !== "legendonly" && (each.type === "mesh3d" || each.type === "scatter3d"); });
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const solid = traces.map(function (trace) {
      const points = ["x", "y", "z"].map(function (name) { return numbers(trace[name]); });
      points.forEach(function (values, n) { for (const value of values) { if (value < low[n]) low[n] = value; if (value > high[n]) high[n] = value; } });
      return { trace, points };
    });
    const size = [0, 1, 2].map(function (n) { return Math.max(high[n] - low[n], 1e-12); });
    return { solid, low, high, middle: [0, 1, 2].map(function (n) { return 0.5 * (low[n] + high[n]); }), scale: Math.cbrt(size[0] * size[1] * size[2]) };
  }
  function sketch(figure) {
    const found = figure.found, width = figure.width, height = found.layout.height;
    if (!figure.shape) figure.shape = solidOf(found);
    const shape = figure.shape, view = figure.view || found.layout.scene.camera, center = view.center || { x: 0, y: 0, z: 0 };
    let canvas = figure.drawing.querySelector("canvas.sketch");
    if (!canvas) {
      figure.drawing.textContent = "";
      figure.drawing.classList.remove("waiting");
      canvas = document.createElement("canvas");
      canvas.className = "sketch";
      const button = document.createElement("button");
      button.type = "button";
      button.className = "turn";
      button.textContent = "Turn in 3D";
      figure.drawing.append(canvas, button);
    }
    const pixel = Math.min(2, devicePixelRatio || 1);
    canvas.width = width * pixel;
    canvas.height = height * pixel;
    const pen = canvas.getContext("2d");
    pen.scale(pixel, pixel);
    const eye = [view.eye.x, view.eye.y, view.eye.z], toward = [center.x, center.y, center.z], up = view.up || { x: 0, y: 0, z: 1 };
    const away = unit(eye.map(function (value, n) { return value - toward[n]; })), right = unit(cross([up.x, up.y, up.z], away)), top = cross(away, right);
    /* With room for the numbers beside the box. */
    const focal = 0.46 * Math.min(width, 0.93 * height) / Math.tan(0.5 * FIELD_OF_VIEW_RAD);
    const seen = function (x, y, z) {
      const p = [(x - shape.middle[0]) / shape.scale - eye[0], (y - shape.middle[1]) / shape.scale - eye[1], (z - shape.middle[2]) / shape.scale - eye[2]];
      const depth = Math.max(-dot(p, away), 1e-3);
      return [0.5 * width + focal * dot(p, right) / depth, 0.465 * height - focal * dot(p, top) / depth, depth];
    };
    /* Far parts first. */
    const parts = [];
    for (const { trace, points } of shape.solid) {
      const count = points[0].length, at = new Array(count);
      for (let k = 0; k < count; k++) at[k] = seen(points[0][k], points[1][k], points[2][k]);
      if (trace.type === "mesh3d") {
        const i = numbers(trace.i), j = numbers(trace.j), l = numbers(trace.k), grey = trace.intensity ? numbers(trace.intensity) : null;
        const color = grey ? null : colorAt([[0, trace.color], [1, trace.color]], 0);
        for (let k = 0; k < i.length; k++) {
          const a = i[k], b = j[k], c = l[k];
          const edge = function (to) { return [points[0][to] - points[0][a], points[1][to] - points[1][a], points[2][to] - points[2][a]]; };
          const light = 0.7 + 0.3 * Math.abs(dot(unit(cross(edge(b), edge(c))), LIGHT));
          const tone = grey ? new Array(3).fill((grey[a] + grey[b] + grey[c]) / 3) : color;
          parts.push([(at[a][2] + at[b][2] + at[c][2]) / 3, 0, [at[a], at[b], at[c]], "rgb(" + tone.map(function (part) { return Math.round(light * part); }).join() + ")", trace.opacity || 1]);
        }
      } else if (trace.mode.includes("lines")) {
        for (let k = 1; k < count; k++) parts.push([0.5 * (at[k - 1][2] + at[k][2]), 1, [at[k - 1], at[k]], trace.line.color, 0.5 * trace.line.width]);
        if (trace.text && trace.mode.includes("text")) trace.text.forEach(function (word, k) { if (word) parts.push([at[k][2], 3, [at[k]], trace.textfont.color, word]); });
      } else {
        const values = trace.marker.color, scale = trace.marker.colorscale, many = values && values.bdata ? numbers(values) : null;
        const low = many ? (trace.marker.cmin ?? Math.min(...many)) : 0, high = many ? (trace.marker.cmax ?? Math.max(...many)) : 1;
        for (let k = 0; k < count; k++) parts.push([at[k][2], 2, [at[k]], many ? "rgb(" + colorAt(scale, (many[k] - low) / (high - low || 1)).join() + ")" : values, 0.5 * trace.marker.size]);
      }
    }
    parts.sort(function (a, b) { return b[0] - a[0]; });
    box(pen, shape, found, seen, width);
    pen.lineCap = "round";
    for (const [, kind, at, color, more] of parts) {
      pen.fillStyle = pen.strokeStyle = color;
      pen.beginPath();
      if (kind === 2) { pen.arc(at[0][0], at[0][1], more, 0, 7); pen.fill(); continue; }
      if (kind === 3) { pen.font = "13px sans-serif"; pen.fillText(more, at[0][0] + 4, at[0][1] - 4); continue; }
      pen.moveTo(at[0][0], at[0][1]);
      for (let k = 1; k < at.length; k++) pen.lineTo(at[k][0], at[k][1]);
      if (kind === 1) { pen.lineWidth = more; pen.stroke(); continue; }
      pen.globalAlpha = more;
      pen.fill();
      /* Without a seam between neighbours. */
      if (more === 1) { pen.lineWidth = 0.6; pen.stroke(); }
      pen.globalAlpha = 1;
    }
    figure.sketched = true;
  }
  /* At most so many round numbers from low to high. */
  function roundNumbers(low, high, most) {
    const least = (high - low) / Math.min(5, most), power = Math.pow(10, Math.floor(Math.log10(least)));
    const step = [1, 2, 5, 10].map(function (each) { return each * power; }).find(function (each) { return each >= least; });
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }
  /* Of the four edges along an axis the outermost, rather below or on the left: its ends and the way out, in pixels. */
  function outline(corner, n) {
    const edges = [0, 1, 2, 3].map(function (k) {
      const low = [k & 1, k >> 1], high = low.slice();
      low.splice(n, 0, 0);
      high.splice(n, 0, 1);
      return [corner(...low), corner(...high)];
    });
    const middle = [0, 1].map(function (k) { return edges.reduce(function (sum, each) { return sum + 0.125 * (each[0][k] + each[1][k]); }, 0); });
    const found = edges.map(function ([a, b]) {
      const away = [0.5 * (a[0] + b[0]) - middle[0], 0.5 * (a[1] + b[1]) - middle[1]], size = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
      let out = [(a[1] - b[1]) / size, (b[0] - a[0]) / size], reach = out[0] * away[0] + out[1] * away[1];
      if (reach < 0) { out = [-out[0], -out[1]]; reach = -reach; }
      return { a, b, out, reach: reach * (1 + 0.3 * (out[1] - 0.5 * out[0])) };
    });
    return found.reduce(function (best, each) { return each.reach > best.reach ? each : best; });
  }
  /* The edges of the box around everything, and at three of them numbers and title of the axis; from so near that the box is cut, none. */
  function box(pen, shape, found, seen, width) {
    const ends = [shape.low, shape.high], corner = function (a, b, c) { return seen(ends[a][0], ends[b][1], ends[c][2]); };
    const scene = found.layout.scene, height = found.layout.height;
    for (let k = 0; k < 8; k++) {
      const [x, y] = corner(k & 1, k >> 1 & 1, k >> 2 & 1);
      if (x < -0.05 * width || x > 1.05 * width || y < -0.05 * height || y > 1.05 * height) return;
    }
    pen.strokeStyle = scene.xaxis.gridcolor;
    pen.lineWidth = 1;
    for (let k = 0; k < 8; k++) for (let n = 0; n < 3; n++) if (!(k >> n & 1)) {
      const other = k | 1 << n, a = corner(k & 1, k >> 1 & 1, k >> 2 & 1), b = corner(other & 1, other >> 1 & 1, other >> 2 & 1);
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      pen.stroke();
    }
    pen.fillStyle = found.layout.font.color;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    [scene.xaxis, scene.yaxis, scene.zaxis].forEach(function (axis, n) {
      const { a, b, out } = outline(corner, n), at = function (share, off) { return [a[0] + share * (b[0] - a[0]) + off * out[0], a[1] + share * (b[1] - a[1]) + off * out[1]]; };
      const length = Math.hypot(b[0] - a[0], b[1] - a[1]), low = shape.low[n], span = shape.high[n] - low;
      pen.font = axis.tickfont.size + "px sans-serif";
      if (length > 40) for (const value of roundNumbers(low, low + span, length / 45)) pen.fillText(String(Number(value.toPrecision(6))).replace("-", "\u2212"), ...at((value - low) / span, 15));
      pen.font = "12px sans-serif";
      pen.save();
      pen.translate(...at(0.5, 36));
      pen.rotate(length > 40 ? Math.atan((b[1] - a[1]) / (b[0] - a[0] || 1e-9)) : 0);
      pen.fillText(axis.title.text.replace(/<[^>]*>/g, ""), 0, 0);
      pen.restore();
    });
    pen.textBaseline = "alphabetic";
    pen.textAlign = "left";
  }
  async function drawSketch(figure) {
    if (figure.text === null) figure.text = await inflated(figure.node);
    if (figure.drawn) return;
    const start = performance.now();
    figure.found = content(figure);
    sketch(figure);
    placeAll(figure);
    performance.measure("sketch-" + figure.drawing.id, { start });
  }
  async function draw(figure) {
    if (figure.text === null) figure.text = await inflated(figure.node);
    await loadLibrary();
    if (figure.drawn) return;
    const found = figure.found = content(figure), start = performance.now();
    figure.drawn = true;
    figure.drawing.classList.remove("waiting");
    figure.drawing.textContent = "";
    await Plotly.newPlot(figure.drawing, found.data, found.layout, CONFIG);
    figure.drawing.on("plotly_afterplot", function () { placeMoments(figure); });
    placeAll(figure);
    performance.measure(figure.drawing.id, { start });
  }
  function redraw(figure) {
    if (figure.sketched && !figure.drawn) {
      figure.stale = false;
      figure.found = content(figure);
      figure.shape = null;
      sketch(figure);
      placeAll(figure);
    }
    if (!figure.drawn) return;
    figure.stale = false;
    const found = content(figure);
    Plotly.react(figure.drawing, found.data, found.layout, CONFIG);
    placeAll(figure);
  }
  /* Drawn in the other scheme, or for another width. */
  function isOld(figure) {
    const width = figure.plot.clientWidth;
    return (figure.drawn || figure.sketched) && (figure.stale || (width > 0 && width !== figure.width));
  }
  let drawing = null;
  function isShown(figure) { return figure.drawn || (figure.sketched && !figure.asked); }
  function wanted() {
    const open = figures.filter(function (each) { return !isShown(each); });
    return open.find(function (each) { return each.asked && each.inView; }) || open.find(function (each) { return each.inView && isSolid(each); })
      || open.find(function (each) { return each.inView; }) || open.find(function (each) { return each.near; });
  }
  async function drawWanted() {
    for (let next = wanted(); next; next = wanted()) {
      if (isSolid(next) && !next.asked) await drawSketch(next);
      else await draw(next);
      noteProgress();
      /* The browser answers the reader between two figures. */
      await new Promise(function (resolve) { setTimeout(resolve, 0); });
    }
  }
  function drawNear() {
    if (!drawing) drawing = drawWanted().finally(function () { drawing = null; noteProgress(); if (wanted()) drawNear(); });
    return drawing;
  }
  /* For measurements: milliseconds until all that is in view was drawn, and whether everything is. */
  function noteProgress() {
    const data = document.body.dataset;
    if (!data.shown && !figures.some(function (each) { return each.inView && !isShown(each); })) data.shown = Math.round(performance.now());
    if (figures.every(function (each) { return each.drawn; })) data.drawn = "yes";
  }
  /* All figures, or those of a part of the page, which may be the drawing of one. */
  async function drawAll(part) {
    for (const each of figures) if (!part || part.contains(each.plot) || each.plot.contains(part)) each.near = each.asked = true;
    while (wanted()) await drawNear();
    for (const each of figures) if (isOld(each)) redraw(each);
  }
  const byNode = new Map(figures.map(function (each) { return [each.plot, each]; }));
  const near = new IntersectionObserver(function (entries) {
    for (const entry of entries) if (entry.isIntersecting) byNode.get(entry.target).near = true;
    drawNear();
  }, { rootMargin: "500px 0px" });
  const seen = new IntersectionObserver(function (entries) {
    for (const entry of entries) {
      const figure = byNode.get(entry.target);
      figure.inView = entry.isIntersecting;
      if (figure.inView && isOld(figure)) redraw(figure);
      else if (figure.inView && isShown(figure)) placeAll(figure);
    }
    noteProgress();
    drawNear();
  });
  for (const each of figures) { seen.observe(each.plot); near.observe(each.plot); }
  /* The real 3D figure when the pointer rests on it, or with a touch or the button. */
  function ask(figure) { figure.asked = figure.near = true; drawNear(); }
  for (const each of figures.filter(isSolid)) {
    let rest = 0;
    each.plot.addEventListener("pointerenter", function () { rest = setTimeout(function () { ask(each); }, REST_MS); });
    each.plot.addEventListener("pointerleave", function () { clearTimeout(rest); });
    each.plot.addEventListener("click", function () { ask(each); });
  }

  /* What is not in view yet, while nothing else is to be done: so that a print has all of it. */
  const PAUSE_MS = 1500, whenIdle = function (act) { if (window.requestIdleCallback) requestIdleCallback(act, { timeout: 1000 }); else setTimeout(act, 50); };
  function drawNextIdle() {
    const next = figures.find(function (each) { return !isShown(each); });
    if (!next || !document.body.dataset.shown) return;
    next.near = true;
    drawNear().then(function () { whenIdle(drawNextIdle); });
  }
  setTimeout(function () { whenIdle(drawNextIdle); }, PAUSE_MS);

  /* Colour scheme: the system's, or what the switch was set to. */
  /* Now where the reader looks, elsewhere when it comes into view. */
  function refresh(figure) {
    if (figure.inView) redraw(figure);
    else figure.stale = figure.drawn || figure.sketched;
  }
  function redrawAll() { figures.forEach(refresh); }
  dark.addEventListener("change", function () { if (!root.dataset.scheme) redrawAll(); });
  for (const button of document.querySelectorAll(".switch")) button.addEventListener("click", function () {
    root.dataset.scheme = isDark() ? "light" : "dark";
    try { localStorage.setItem("polhode-scheme", root.dataset.scheme); } catch (error) { /* not kept, where a page may store nothing */ }
    redrawAll();
  });
  let resized = 0;
  window.addEventListener("resize", function () {
    clearTimeout(resized);
    resized = setTimeout(function () {
      for (const each of figures) if (isOld(each)) refresh(each);
    }, 150);
  });

  /* The slider: one moment in the picture, the body, the polhode and the plots. */
  const clock = document.querySelector(".clock"), lineNode = document.getElementById("timeline");
  let line = null, pictures = [], stop = 0, playing = 0;
  if (clock && lineNode) inflated(lineNode).then(function (text) {
    line = JSON.parse(text);
    const filmNode = document.getElementById("film-frames");
    pictures = filmNode ? JSON.parse(filmNode.textContent) : [];
    const slider = clock.querySelector("input");
    slider.max = line.time.length - 1;
    slider.value = 0;
    slider.addEventListener("input", function () { pause(); show(Number(slider.value)); });
    clock.querySelector("button").addEventListener("click", function () { if (playing) pause(); else play(); });
    clock.hidden = false;
    show(0);
  });
  function show(index) {
    stop = index;
    clock.querySelector("input").value = index;
    clock.querySelector("output").innerHTML = '<span class="long">frame ' + (line.frame[index] + 1) + " of " + line.frames + ", </span>" + line.time[index].toFixed(1) + " s";
    const film = document.getElementById("film");
    if (film && line.picture && pictures.length) film.src = pictures[line.picture[index]];
    for (const each of figures) if (isShown(each) && each.inView) placeAll(each);
  }
  function placeAll(figure) {
    if (!line) return;
    placeMoments(figure);
    if (figure.drawing.id === "plot-polhode") movePoint(figure);
    if (figure.drawing.id === "plot-mesh" || figure.drawing.id === "plot-sparse-map") turnBody(figure);
  }
  function placeMoments(figure) {
    const full = figure.drawing._fullLayout;
    if (!line || !figure.clock || !full || !full._plots) return;
    const value = figure.clock === "time" ? line.time[stop] : line.frame[stop] + 1;
    const panels = Object.values(full._plots).filter(function (panel) { return panel.xaxis._id === "x" || panel.xaxis.matches === "x"; });
    while (figure.moments.length < panels.length) {
      const mark = document.createElement("div");
      mark.className = "moment";
      figure.plot.append(mark);
      figure.moments.push(mark);
    }
    panels.forEach(function (panel, k) {
      const x = panel.xaxis, y = panel.yaxis, at = x.d2p(value), style = figure.moments[k].style;
      style.display = at >= 0 && at <= x._length ? "" : "none";
      style.left = x._offset + at - 1 + "px";
      style.top = y._offset + "px";
      style.height = y._length + "px";
    });
  }
  function movePoint(figure) {
    const rate = line.rate[stop];
    if (!figure.drawn) {
      if (!figure.shape) return;
      const point = figure.shape.solid.at(-1).points;
      for (let n = 0; n < 3; n++) point[n] = [rate[n]];
      return sketch(figure);
    }
    const data = figure.drawing.data, index = data.length - 1;
    Plotly.restyle(figure.drawing, { x: [[rate[0]]], y: [[rate[1]]], z: [[rate[2]]] }, [index]);
  }
  function turnBody(figure) {
    if (!line.eye) return;
    /* As far as the first view, which shows the whole body. */
    const first = figure.found.layout.scene.camera.eye, away = Math.hypot(first.x, first.y, first.z);
    const eye = line.eye[stop], up = line.up[stop], vector = function (v, scale) { return { x: scale * v[0], y: scale * v[1], z: scale * v[2] }; };
    figure.view = { eye: vector(eye, away), up: vector(up, 1), center: { x: 0, y: 0, z: 0 } };
    if (figure.drawn) Plotly.relayout(figure.drawing, { "scene.camera": figure.view });
    else if (figure.shape) sketch(figure);
  }
  function play() {
    clock.querySelector("button").textContent = "Pause";
    const pause_ms = Math.max(60, 12000 / line.time.length);
    playing = setInterval(function () { show((stop + Math.max(1, Math.round(line.time.length / 200))) % line.time.length); }, pause_ms);
  }
  function pause() {
    clearInterval(playing);
    playing = 0;
    clock.querySelector("button").textContent = "Play";
  }

  /* Contents: where the reader is, and sections that open when they are asked for. */
  const sections = Array.from(document.querySelectorAll("main [id].section, main h2[id]"));
  function mark() {
    let here = "";
    for (const each of sections) if (each.getBoundingClientRect().top < 0.4 * innerHeight) here = each.id;
    for (const link of document.querySelectorAll(".side a, .menu a")) link.classList.toggle("here", link.hash === "#" + here);
  }
  let marking = false;
  addEventListener("scroll", function () {
    if (marking) return;
    marking = true;
    requestAnimationFrame(function () { marking = false; mark(); });
  }, { passive: true });
  mark();
  for (const link of document.querySelectorAll(".side a, .menu a")) link.addEventListener("click", function () {
    const target = document.getElementById(link.hash.slice(1));
    if (target && target.tagName === "DETAILS") target.open = true;
    const menu = link.closest(".menu");
    if (menu) menu.open = false;
  });

  /* Print: light, everything open and drawn, drawings as wide as the paper. */
  let folded = [];
  addEventListener("beforeprint", function () {
    folded = Array.from(document.querySelectorAll("details:not([open]):not(.menu)"));
    for (const each of folded) each.open = true;
    isPrinting.now = true;
    figures.forEach(redraw);
  });
  addEventListener("afterprint", function () {
    isPrinting.now = false;
    for (const each of folded) each.open = false;
    redrawAll();
  });
  async function print() { await drawAll(); window.print(); }
  for (const button of document.querySelectorAll(".print")) button.addEventListener("click", print);
  addEventListener("keydown", function (event) {
    if ((event.ctrlKey || event.metaKey) && event.key === "p" && document.body.dataset.drawn !== "yes") { event.preventDefault(); print(); }
  });

  window.polhodeReport = { drawAll: drawAll, show: function (index) { show(index); }, stops: function () { return line ? line.time.length : 0; } };
})();
